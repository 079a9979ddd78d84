"""Measures that a chain does not allow: each names the property that it does not support."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run
from helpers.faults import faults

from lmpchain import Impulse, Law
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
from lmpchain.measure.fit import fit_bessel, fit_continuum, fit_exponents, fit_modes, fit_soliton

COLUMN_LAWS = [fit_continuum, fit_exponents]
LONG_WAVES = [lambda t: dyson.sums(t, [1.0]), lambda t: spectrum.travel_time(t.scene.chain)]
STRONG_WAVES = [solitary.find, collision.find, fit_soliton]
SHOCKS = [shock.find, planar.orbits, self_similar.view]
IN_TIME = Law("k*u*(1 + 0.5*sin(w*t))", k=1e3, w=1e5)
BY_FORMULA = Law("k*o*(1 + o/c)", k=1e5, c=1e-6)
VACUUM = {"gravity": 0.0}
UNEVEN = {"gravity": 0.0, "grains": 30, "diameter": np.linspace(1e-3, 1.1e-3, 30)}
# The key of the fault, the chain, options of the run, and the measures.
REFUSED: dict[str, tuple[str, dict[str, Any], dict[str, Any], list[Callable[..., Any]]]] = {
    "a ground": (
        "chain.ground",
        {"ground": Law("k*u", k=1e3)},
        {},
        [*COLUMN_LAWS, *LONG_WAVES, *STRONG_WAVES, *SHOCKS, fit_bessel, wavenumbers.bands],
    ),
    "a ground in time": ("chain.ground", {"ground": IN_TIME}, {}, [energy.ledger, energy.shares]),
    "loose grains": (
        "chain.load_grain",
        VACUUM | {"top_load": 1.0, "load_grain": 4},
        {},
        [*LONG_WAVES, fit_bessel, fit_modes],
    ),
    "a law by formula": ("chain.law", {"law": BY_FORMULA}, {}, COLUMN_LAWS),
    "damping": ("damping", VACUUM | {"damping": {"drag": 1.0}}, {}, STRONG_WAVES[:2]),
    "gravity": ("gravity", {}, {}, STRONG_WAVES),
    "springs": ("exponent", VACUUM | {"exponent": 1.0, "top_load": 1.0}, {}, STRONG_WAVES),
    "other grains": ("chain", UNEVEN, {}, [collision.find, *SHOCKS]),
    "grains that were not recorded": (
        "grains",
        VACUUM | {"grains": 30},
        {"grains": [1, 2, 3]},
        [*STRONG_WAVES[:2], *SHOCKS, wavenumbers.bands],
    ),
    "few grains": ("chain", VACUUM, {"samples": 40}, [solitary.find, *SHOCKS]),
    "few samples": ("chain", VACUUM | {"grains": 40}, {}, [solitary.find]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_measure_names_what_it_does_not_support(name: str) -> None:
    """Every measure that needs a property of the chain or of the run names it if it is missing."""
    key, chain, options, measures = REFUSED[name]
    t = run(
        column(**{"grains": 12} | chain),
        Impulse(velocity=1e-6),
        1e-6,
        **{"samples": 3, "tolerance": 1e-6} | options,
    )
    for measure in measures:
        assert faults(measure, t)[0][0] == key
