"""Measure the constants of the model error of linear theory.

Random compressed chains, weakly to strongly struck, at the top, within, all over or driven, for up
to hundreds of periods: the linear solution by eigenmodes is held against the nonlinear one by the
native engine at a tolerance of 1e-9, which knows nothing of linear theory. The factor of the
estimate (strays) is fitted on every other scene: it is the least with which 99 in 100 thirds of the
truth hold, the other parts being as they are. It is supported from what the other half of the
scenes needs in the same way, where it has not been fitted, up to what the fitted half would need of
it alone, the other parts being nothing: more than that is never needed. A bound has to hold always:
doubt is supported from the most that any scene needs, of these and of families that ask for more
(`columns`: struck columns of few grains up to ten passages; `pushed`: drives of many grains), up to
half as much again as any needs alone. Large is supported up to the least bound that the truth
exceeds, were bounds not given as 1 from there on. Steepens is supported like doubt, from `trains`:
packets and driven waves that travel through long chains, as no other scene asks for it. STEEPEST
and LINEAR come from struck columns.

    python analysis/calibration/linear_model_error.py           # half a minute
    python analysis/calibration/linear_model_error.py --quick   # seconds
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import NamedTuple
from unittest import mock

import numpy as np
from common import Row, answer, command, distance, quantile
from scenes import drawn, trains

from lmpchain import Chain, Impulse, Scene
from lmpchain.engines.linear import model_error
from lmpchain.engines.linear.engine import Modes
from lmpchain.engines.linear.model_error import FACTORS, LOOKS, PhaseError
from lmpchain.engines.native import Native
from lmpchain.errors import InputError, RunFailed, ToleranceNotMet
from lmpchain.measure.front import track
from lmpchain.simulation.api import simulate
from lmpchain.stability.linear_theory import LINEAR, STEEPEST
from lmpchain.theory.domain import exponents

SMALL = 0.3  # Larger errors saturate.
LOW = 3.0  # Factor by which an estimate may be below the true error.
DEPTH = 20  # Grain whose peak is followed.
MARGIN = 1.5  # Factor on the largest bound that any scene needs, for scenes that were not drawn.
TRUTH = 1e-9  # Tolerance of the nonlinear solution.


def phase_error(scene: Scene) -> PhaseError:
    """Return the extremes of a linear solution, evaluated as in a run of the engine."""
    run = Modes().start([scene], Modes().propose(scene, 1.0))
    for _ in run.blocks():
        pass
    return run._phase_errors[0]  # type: ignore[attr-defined]


def nonlinear(scene: Scene) -> np.ndarray | None:
    """Return the nonlinear motion (2, T, G); None if it is unknown."""
    try:
        run = simulate(scene, Native(), TRUTH)
    except (ToleranceNotMet, RunFailed):
        return None
    return np.array([run.displacement, run.velocity])


def linear(scene: Scene) -> np.ndarray:
    """Return the linear motion (2, T, G)."""
    run = answer(Modes(), scene, Modes().propose(scene, 1.0))
    assert run
    return run.motion


class Held(NamedTuple):
    """The true error of linear theory in a scene, and the package's estimates."""

    true: float
    found: PhaseError


def held(scenes: list[Scene]) -> list[Held]:
    """Compare linear theory with the nonlinear motion."""
    rows = []
    for scene in scenes:
        if not Modes().refuses(scene) and (true := nonlinear(scene)) is not None:
            rows.append(Held(distance(linear(scene), true), phase_error(scene)))
    return [row for row in rows if row.true > 1e-7 and not row.found.remark]


class Need(NamedTuple):
    """The factor that a scene requires for a part of the error: with other parts, and alone."""

    beside: float
    alone: float


def _part(wanted: float, unit: float, instead: float) -> Need:
    """Return the factor of `unit` that gives the wanted value; `instead` if it is large enough."""
    return Need(0.0 if wanted <= instead else wanted / unit, wanted / unit)


def _strays(x: Held) -> Need:
    others = max(x.found.shifted, x.found.resonant)
    return _part(x.true / LOW, x.found.strayed / FACTORS.strays, others)


def _factor(name: str, shipped: float, needs: list[Need]) -> Row:
    """Return the row of a factor: fitted on every other scene, and tested on the others."""
    fitted = needs[::2]
    other = needs[1::2]
    enough = sum(need.beside <= shipped for need in other)
    return Row(
        name,
        shipped,
        *(quantile([need.beside for need in half], 0.99) for half in (fitted, other)),
        quantile([need.alone for need in fitted], 0.99),
        f"fitted to {len(fitted)} scenes; enough in {enough} of {len(other)} others",
    )


def _bounds(found: list[Held], trains: list[Held]) -> list[Row]:
    """Return the rows of the factors of bounds, the largest of which must always hold."""
    rows = []
    for name, asking in (("doubt", found), ("steepens", trains)):
        factor = getattr(FACTORS, name)
        parts = []
        for x in asking:
            scattered = x.found.scattered
            steepened = x.found.steepens / FACTORS.steepens
            unit, instead = (
                (scattered, x.found.steepens)
                if name == "doubt"
                else (steepened, FACTORS.doubt * scattered)
            )
            if unit:
                parts.append(_part(x.true, unit, instead))
        beside, alone = (max(part[k] for part in parts) for k in (0, 1))
        says = (
            f"most that any of {len(parts)} scenes needs: beside the others {beside:.3g}, alone "
            f"{alone:.3g}"
        )
        rows.append(
            Row(f"FACTORS.{name}", factor, beside, beside, MARGIN * max(alone, beside), says)
        )
    return rows


def _large(found: list[Held]) -> Row:
    """Return the row of the bound from which the estimate is 1."""
    bounds = [(FACTORS.doubt * x.found.scattered, x.true) for x in found]
    least = min((bound for bound, true in bounds if bound < min(true, 1.0)), default=1.0)
    says = f"least bound that is below the truth, of {len(found)} scenes"
    return Row("FACTORS.large", FACTORS.large, least, SMALL, least, says)


def columns(quick: bool) -> list[Scene]:
    """Return struck columns of few grains over ten passages, up to a strain of 0.99."""
    scenes = []
    for exponent in (1.5,) if quick else (1.1, 1.3, 1.5, 1.8, 2.2):
        for grains in (2,) if quick else (2, 3, 4, 8):
            chain = Chain(grains=grains, diameter=1e-3, exponent=exponent)
            passage = float(np.sqrt(chain.masses[0] / chain.linear_stiffness).sum())
            one = Scene(
                chain=chain,
                excitation=Impulse(velocity=1e-6),
                duration=9.999 * passage,
                samples=201,
            )
            for strain in (1e-3, 0.3, 0.8, 0.99):
                strike = Impulse(velocity=1e-6 * strain / one.linear_strain)
                scenes.append(one.replace(excitation=strike))
    return scenes


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 24 if quick else 240
    ranges = {
        "kinds": ("gravity", "load", "both"),
        "exponents": (1.1, 1.25, 1.5, 1.5, 2.0, 2.5, 3.0),
        "samples": 101,
    }
    scenes = drawn(count // 2, 41, strength=(-4.0, 0.3), spans=(2.0, 60.0), **ranges)
    scenes += drawn(count // 2, 42, strength=(-4.0, -0.5), spans=(60.0, 400.0), **ranges)
    found = [x for x in held(scenes) if x.true < SMALL]
    pushed = {
        "kinds": ranges["kinds"],
        "exponents": (2.0, 2.5, 3.0),
        "samples": 101,
        "grains": (13, 16, 20, 30),
    }
    asking = drawn(
        3 * count // 4, 920, strength=(-3.0, -0.3), spans=(5.0, 100.0), driven=1.0, **pushed
    )
    asking += drawn(count // 3, 43, strength=(-3.0, -0.5), spans=(0.2, 1.5), **ranges)
    strong = held(asking + columns(quick))
    bounded = found + [x for x in strong if x.true < SMALL]
    travelling = [x for x in held(trains(count // 3, 44)) if x.true < SMALL]
    rows = [
        *_bounds(bounded, travelling),
        _large(strong),
        _factor("FACTORS.strays", FACTORS.strays, [_strays(x) for x in found]),
    ]
    rows += [_evenly(scenes[: count // 3])]
    return rows + _columns(quick)


def _evenly(scenes: list[Scene]) -> Row:
    """Return the row of the constant `evenly`.

    The fewest looks with which 19 in 20 bounds are within 30 % of those of many looks.
    """
    bound: dict[int, list[float]] = {}
    sparse = [
        Scene(**scene.given() | {"samples": 6}) for scene in scenes if not Modes().refuses(scene)
    ]
    for evenly in (16, 32, 64, 128, 1024):
        with mock.patch.object(model_error, "LOOKS", replace(LOOKS, evenly=evenly)):
            bound[evenly] = [phase_error(scene).at_most for scene in sparse]
    off = {
        n: quantile(np.abs(np.array(x) / np.array(bound[1024]) - 1), 0.95) for n, x in bound.items()
    }
    good = [n for n, x in off.items() if x < 0.3]
    listed = ", ".join(f"{n}: {100 * x:.0f} %" for n, x in off.items() if n != 1024)
    return Row(
        "LOOKS.evenly",
        LOOKS.evenly,
        min(good),
        min(good),
        max(2 * min(good), LOOKS.evenly),
        f"bound off from that of 1024 looks, 95 % of scenes: {listed}",
    )


def _errors(
    delta: float, strike_number: float, tau: float, grains: int, gravity: float = 9.81
) -> dict[str, float]:
    """Return the errors of linear theory in its four norms after a strike on top of a column."""
    chain = Chain(grains=grains, diameter=1e-3, exponent=delta, gravity=gravity)
    unit = chain.length_scale / chain.time_scale
    scene = Scene(
        chain=chain,
        excitation=Impulse(velocity=strike_number * unit),
        duration=tau * chain.time_scale,
        samples=1001,
    )
    with warnings.catch_warnings(action="ignore"):
        runs = [simulate(scene, engine, TRUTH) for engine in (Modes(), Native())]
    found, true = (np.array([run.displacement, run.velocity]) for run in runs)
    try:
        peaks = [track(run).between(DEPTH, DEPTH).amplitude[0] for run in runs]
    except (InputError, IndexError):  # No front has passed at this depth.
        peaks = []
    return {
        "velocity": float(np.linalg.norm((found - true)[1, -1]) / np.linalg.norm(true[1, -1])),
        "displacement": float(np.abs(found - true)[0].max() / np.abs(true[0]).max()),
        "package": distance(found, true),
        "peak": float(abs(peaks[0] / peaks[1] - 1)) if peaks else math.nan,
    }


def _spread(norm: str, delta: float) -> float:
    """Return the growth of a norm with depth."""
    return float(DEPTH ** (0.75 * exponents(delta)[0] - 0.5)) if norm == "peak" else 1.0


def _columns(quick: bool) -> list[Row]:
    """Return the rows of struck columns: LINEAR and STEEPEST."""
    taus, deltas = ((20.0,), (1.5,)) if quick else ((20.0, 25.0), (1.1, 1.3, 1.5, 1.8, 2.2))
    weak = 2e-3
    runs = [
        (delta, _errors(delta, weak / (delta - 1), tau, 80)) for delta in deltas for tau in taus
    ]
    rows = []
    for norm, (slope, limit) in LINEAR.items():
        slopes = [errors[norm] / weak / _spread(norm, delta) for delta, errors in runs]
        rows.append(
            Row(
                f"LINEAR[{norm}][0]",
                slope,
                quantile(slopes, 0.5),
                0.9 * min(slopes),
                1.1 * max(slopes),
                f"error over (delta - 1) v0*, delta {min(deltas)} to {max(deltas)}, "
                f"{min(slopes):.3g} to {max(slopes):.3g}, and 10 %",
            )
        )
        limits = []
        for delta in (1.5,) if quick else (1.3, 1.5, 2.0):
            x = 0.1 / (1 - 0.1 / limit)
            error = _errors(delta, x / slope / _spread(norm, delta) / (delta - 1), 20.0, 80)[norm]
            if not math.isnan(error):
                limits.append(1 / max(1 / error - 1 / x, 0.1))
        rows.append(
            Row(
                f"LINEAR[{norm}][1]",
                limit,
                quantile(limits, 0.5),
                min(limits) / 1.5,
                1.5 * max(limits),
                f"limit that gives the error near 0.1, {min(limits):.2g} to {max(limits):.2g}, and "
                "half as much",
            )
        )
    package = LINEAR["package"][0]
    ratios = {
        delta: _errors(delta, weak / (delta - 1), 20.0, 80)["package"] / weak / package
        for delta in (2.0, 2.2, 2.4, 2.7, 3.0)
    }
    good = max((delta for delta, ratio in ratios.items() if abs(ratio - 1) < 0.1), default=1.0)
    listed = ", ".join(f"{delta:g}: {ratio:.2f}" for delta, ratio in ratios.items())
    rows.append(
        Row(
            "STEEPEST",
            STEEPEST,
            good,
            1.0,
            max(d for d, r in ratios.items() if r < 2),
            f"error over that of LINEAR, by exponent: {listed}; right to 10 % up to {good:g}, to 2 "
            "further",
        )
    )
    return rows


if __name__ == "__main__":
    command(main, __doc__)
