"""Measures that a chain does not allow: each names the property that it does not support."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from helpers.example_chains import column
from helpers.example_scenes import run
from helpers.faults import faults

from lmpchain import Impulse, Law, Trajectory
from lmpchain.measure import (
    collision,
    dyson,
    energy,
    planar,
    self_similar,
    shock,
    solitary,
    spectrum,
    wavenumbers,
)
from lmpchain.measure.fit import (
    fit_bessel,
    fit_continuum,
    fit_exponents,
    fit_modes,
    fit_soliton,
)

CHAINS: dict[str, dict[str, Any]] = {
    "chain.ground": {"ground": Law("k*u", k=1e3)},
    "chain.ground in time": {"ground": Law("k*u*(1 + 0.5*sin(w*t))", k=1e3, w=1e5)},
    "chain.load_grain": {"gravity": 0.0, "top_load": 1.0, "load_grain": 4},
    "chain.law": {"law": Law("k*o*(1 + o/c)", k=1e5, c=1e-6)},
    "damping": {"gravity": 0.0, "damping": {"drag": 1.0}},
}
COLUMN_LAWS = [fit_continuum, fit_exponents]
LONG_WAVES = [lambda t: dyson.sums(t, [1.0]), lambda t: spectrum.travel_time(t.scene.chain)]
STRONG_WAVES = [solitary.find, collision.find, fit_soliton]
SHOCKS = [shock.find, planar.orbits, self_similar.view]
REFUSED: dict[str, list[Callable[[Trajectory], Any]]] = {
    "chain.ground": [
        *COLUMN_LAWS,
        *LONG_WAVES,
        *STRONG_WAVES,
        *SHOCKS,
        fit_bessel,
        wavenumbers.bands,
    ],
    "chain.ground in time": [energy.ledger, energy.shares],
    "chain.load_grain": [*LONG_WAVES, fit_bessel, fit_modes],
    "chain.law": [*COLUMN_LAWS],
    "damping": [solitary.find, collision.find],
}


@pytest.mark.parametrize("key", REFUSED)
def test_a_measure_names_what_it_does_not_support(key: str) -> None:
    """A force of the ground, loose grains, a law that is no power, or damping is named."""
    chain = column(12, **CHAINS[key])
    t = run(chain, Impulse(velocity=1e-6), 1e-6, 3, 1e-6)
    for measure in REFUSED[key]:
        assert faults(measure, t)[0][0] == key.partition(" ")[0]
