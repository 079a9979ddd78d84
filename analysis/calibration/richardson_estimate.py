"""Measure the constants of the error estimate: TRUST, OPENINGS, FEWEST_STEPS and MANY_STEPS.

Random scenes of every kind are run at some steps with other values of each constant, and the
estimate is held against the true error, which comes from the Taylor series in extended precision. A
value is supported where 99 in 100 estimates are no smaller than the true error, or as many as with
the best value, to one in 200, and where the median one is at most three times that of the tightest
of such values. OPENINGS.near and OPENINGS.returning say where the full order, or two companions
alone, may be trusted: they are supported as far as 99 in 100 of these estimates are bounds.

    python analysis/calibration/richardson_estimate.py           # three minutes
    python analysis/calibration/richardson_estimate.py --quick   # seconds
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from common import (
    ALL_BUT_ONE,
    Case,
    Row,
    answer,
    changed,
    command,
    label,
    proposal,
    sampled,
    with_reach,
)
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.base import Proposal
from lmpchain.engines.native import Native
from lmpchain.engines.stepping import auxiliary_runs
from lmpchain.engines.stepping.auxiliary_runs import FEWEST_STEPS, OPENINGS, TRUST
from lmpchain.integrators.steps import MANY_STEPS

REACHES = (1.6, 0.8, 0.4, 0.2)  # Values of omega h.
SPLITTINGS = ("rkn4", "rkn6", "kahan-li8")
KNOWN = 0.1  # Larger errors follow no order.
CLEAR = 30.0  # Multiple of the rounding error.
RARE = 0.005  # Fraction of estimates by which two values may differ.
WIDE = 3.0  # Largest median estimate, relative to the median of the tightest estimate.


class Look(NamedTuple):
    """A proposed run and its true error."""

    engine: Native
    case: Case
    candidate: Proposal
    error: float

    @property
    def ratio(self) -> float:
        """Ratio of estimate and true error, with the current constants."""
        run = answer(self.engine, self.case.scene, self.candidate)
        return run.error.total / self.error if run else math.nan

    @property
    def crossings(self) -> float:
        """Phase of the fastest motion per grain, or in total for forced scenes."""
        scene = self.case.scene
        crossed = 1 if scene.excitation.does_work else scene.chain.grains
        return scene.highest_frequency * scene.duration / crossed


def look(engine: Native, case: Case, candidate: Proposal, opens: bool | None) -> Look | None:
    """Compare a run with the reference.

    None where its error is round-off, beyond all order, or contacts do not fit.
    """
    run = answer(engine, case.scene, candidate)
    if run is None or opens not in (None, run.lowest <= OPENINGS.near):
        return None
    # With few samples the largest sample may be far below the largest motion of the run.
    error = float((np.abs(run.motion - case.motion).max((1, 2)) / case.reference.scale).max())
    known = CLEAR * run.error.roundoff + 10 * case.reference.error < error < KNOWN
    return Look(engine, case, candidate, error) if known else None


def looks(
    cases: Sequence[Case],
    names: Sequence[str],
    adaptive: bool,
    opens: bool | None = None,
    coarse: bool = False,
    reaches: Sequence[float] = REACHES,
) -> list[Look]:
    """Return runs of the scenes at some steps; `opens` selects those with openings or without."""
    found = []
    for case, name in itertools.product(cases, names):
        engine = Native(name, adaptive=adaptive)
        proposed = proposal(engine, case.scene, 1e-3)
        if proposed is None or proposed.steps.adaptive != adaptive:
            continue
        for reach in reaches:
            candidate = with_reach(case.scene, proposed, reach)
            steps = candidate.steps._replace(coarse_openings=coarse)
            candidate = candidate._replace(steps=steps)
            if reach < engine.methods(case.scene)[0].stability_limit:
                found.append(look(engine, case, candidate, opens))
    return [each for each in found if each]


def judge(
    name: str,
    shipped: float,
    values: Iterable[float],
    change: Callable[[Any], AbstractContextManager[object]],
    found: Sequence[Look],
    what: str,
) -> Row:
    """Return the row of a constant that `change` sets.

    Which estimates are bounds, and how large they are.
    """
    parts: dict[float, float] = {}
    middles: dict[float, float] = {}
    for value in sorted({*values, shipped}):
        with change(value):
            ratios = np.array([each.ratio for each in found])
        parts[value] = float(np.mean(ratios >= 1)) if found else math.nan
        middles[value] = float(np.median(ratios)) if found else math.nan
    enough = min(ALL_BUT_ONE, max(parts.values())) - RARE
    bounds = [value for value, part in parts.items() if part >= enough]
    tightest = min((middles[value] for value in bounds), default=math.nan)
    good = [value for value in bounds if middles[value] <= WIDE * tightest]
    best = min(good, key=lambda value: middles[value], default=math.nan)
    listed = ", ".join(
        f"{value:g}: {100 * part:.1f} ({middles[value]:.2g})" for value, part in parts.items()
    )
    says = (
        f"% of {len(found)} estimates of {what} that are bounds (median over the truth): {listed}"
    )
    return Row(name, shipped, best, min(good, default=math.nan), max(good, default=math.nan), says)


def field(record: Any, name: str, values: Iterable[float], found: Sequence[Look], what: str) -> Row:
    """Return the row of a field of a record."""
    shipped = getattr(record, name)
    return judge(
        label(record, name), shipped, values, lambda x: changed(record, **{name: x}), found, what
    )


def edge(name: str, shipped: float, steps: Sequence[float], where: Callable[[Look], float],
         found: Sequence[Look]) -> Row:  # fmt: skip
    """Return the row of the range of steps in which estimates are bounds, by position."""
    places = np.array([where(each) for each in found])
    bounds = np.array([each.ratio >= 1 for each in found])
    parts = {}
    for begin, end in itertools.pairwise(steps):
        inside = (places - begin) * (places - end) <= 0
        if inside.any():
            parts[end] = float(np.mean(bounds[inside]))
    holds = list(itertools.takewhile(lambda end: parts[end] >= ALL_BUT_ONE - RARE, parts))
    last = max(holds, key=abs, default=steps[0])
    listed = ", ".join(f"{end:g}: {100 * part:.1f}" for end, part in parts.items())
    says = f"% of {len(found)} estimates that are bounds, up to there: {listed}"
    return Row(name, shipped, last, min(steps[0], last), max(steps[0], last), says)


def cases_of(count: int, seed: int, keep: Callable[[Scene], bool], **ranges: object) -> list[Case]:
    """Draw scenes with known true motion."""
    return [case for case in map(Case, drawn(count, seed, keep, **ranges)) if case.known]


def lowest(each: Look) -> float:
    """Return the lowest r / eps of a run, at least -1."""
    run = answer(each.engine, each.case.scene, each.candidate)
    return max(run.lowest, -1.0) if run else -1.0


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 8 if quick else 40
    calm = cases_of(count, 2, lambda s: s.largest_strain < 0.3, strength=(-4, 0.0))
    hard = cases_of(count, 3, lambda s: s.largest_strain > 1, strength=(0.0, 3.0))
    springs = {"exponents": (1.0, 1.0, 1.1, 1.2), "strength": (0.0, 3.0)}
    springy = cases_of(count, 4, lambda s: s.largest_strain > 1, **springs)
    between = cases_of(2 * count, 5, lambda s: 0.3 < s.largest_strain < 3, strength=(-1.0, 1.0))
    hertz = [case for case in hard if case.scene.chain.exponent >= OPENINGS.kinked_below]
    smooth = looks(calm, ("verlet", "rkn4", "rkn6", "kahan-li6"), False)
    equal = looks(hard, ("rkn4", "rkn6"), False, True)
    open_ones = looks(hertz, SPLITTINGS, True, True)
    sprung = looks(springy, SPLITTINGS, True, True, reaches=REACHES[1:])
    coarse = looks(hertz, SPLITTINGS, True, True, coarse=True)
    alone = looks(calm, ("rkn4", "rkn6"), False, reaches=(0.9, 1.2, 1.5))
    return [
        field(TRUST, "safety", (1.0, 1.5, 3.0, 4.0), smooth, "smooth runs"),
        field(
            TRUST, "least_gain", (1.1, 1.25, 2.0, 3.0), [*equal, *sprung], "runs through openings"
        ),
        field(TRUST, "settled", (0.0, 1e-3, 0.03, 0.1), alone, "smooth runs of long steps"),
        _near([*calm, *between]),
        field(OPENINGS, "order", (1, 2, 4, 8), open_ones, "adaptive runs"),
        field(OPENINGS, "coarse_order", (1, 2, 6, 8), coarse, "runs with coarse openings"),
        field(OPENINGS, "equal_order", (1, 1.5, 2.5, 3, 4), equal, "equal steps through openings"),
        field(OPENINGS, "scattered_order", (0.8, 1.25, 1.5, 2, 3), equal, "the same"),
        field(OPENINGS, "kinked_below", (1.0, 1.05, 1.15, 1.4, 1.6), [*sprung, *open_ones], "all"),
        *_returning(count, quick),
        _fewest(count),
        _landings((hard + springy)[:: 3 if quick else 2]),
    ]


def _near(cases: list[Case]) -> Row:
    """Return the row of the lowest r / eps at which equal steps keep the full order."""
    found = looks(cases, ("rkn6",), False)
    with changed(OPENINGS, near=-2.0):
        steps = (0.0, -0.25, -0.5, -0.75, -1.0)
        return edge(label(OPENINGS, "near"), OPENINGS.near, steps, lowest, found)


def _returning(count: int, quick: bool) -> list[Row]:
    """Return the rows of scenes in which waves return to contacts that have opened."""
    rattling = {"grains": (2, 3, 4, 6), "spans": (5.0, 40.0 if quick else 200.0)}
    cases = cases_of(
        2 * count, 11, lambda s: s.largest_strain > 0.5, strength=(-0.5, 2.0), **rattling
    )
    hertz = [case for case in cases if case.scene.chain.exponent >= OPENINGS.kinked_below]
    found = looks(hertz, SPLITTINGS, True, True, reaches=REACHES[1:])
    late = [each for each in found if each.crossings > OPENINGS.returning]
    once = {"exponents": (1.0, 1.0, 1.1), "grains": (2, 3, 4, 6, 10, 20), "strength": (-0.5, 3.0)}
    springy = cases_of(count, 12, lambda s: s.largest_strain > 0.5, spans=(2.0, 80.0), **once)
    sprung = looks(springy, SPLITTINGS, True, True, reaches=REACHES[1:])
    with changed(OPENINGS, returning=math.inf):
        steps = (0.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
        returning = edge(label(OPENINGS, "returning"), OPENINGS.returning, steps,
                         lambda each: each.crossings, found)  # fmt: skip
    ratios = (1.25, 1.5, 1.75, 3.0)
    rattles = "runs in which waves come back"
    return [
        returning,
        field(OPENINGS, "nearby", ratios, late, rattles),
        field(OPENINGS, "nearby_kinked", ratios, sprung, "adaptive runs of springs"),
    ]


def _fewest(count: int) -> Row:
    """Return the row of the fewest steps of a run whose auxiliary runs have longer ones."""
    calm = {"strength": (-4.0, 0.0), "spans": (0.5, 6.0)}
    scenes = drawn(2 * count, 6, lambda s: s.largest_strain < 0.3, **calm)
    short = map(Case, (scene.replace(samples=2) for scene in scenes))
    found = []
    with mock.patch.object(auxiliary_runs, "FEWEST_STEPS", 4):
        for case, name in itertools.product(short, ("verlet", "rkn4", "rkn6", "kahan-li8")):
            engine = Native(name, adaptive=False)
            proposed = proposal(engine, case.scene, 1e-3) if case.known else None
            for count in (4, 5, 6, 8, 12, 16) if proposed else ():
                found.append(look(engine, case, sampled(proposed, count), None))
        runs = [each for each in found if each]
        parts = {}
        for steps in (4, 5, 6, 8, 12, 16):
            each = [run.ratio >= 1 for run in runs if run.candidate.steps.per_landing == steps]
            parts[steps] = float(np.mean(each)) if each else 1.0
    failing = [steps for steps, part in parts.items() if part < ALL_BUT_ONE - RARE]
    first = min((steps for steps in parts if steps > max(failing, default=0)), default=math.nan)
    listed = ", ".join(f"{steps}: {100 * part:.1f}" for steps, part in parts.items())
    says = f"% of {len(runs)} estimates from longer steps that are bounds, by steps: {listed}"
    return Row("FEWEST_STEPS", FEWEST_STEPS, first, first, 4 * first, says)


def _landings(cases: list[Case]) -> Row:
    """Return the row of the number of steps at which auxiliary runs land on each sample."""
    found = []
    for case, name, count in itertools.product(cases, ("rkn4", "dop853"), (9, 17, 33, 65)):
        engine = Native(name)
        proposed = proposal(engine, case.scene, 1e-3)
        if proposed is not None:
            found.append(look(engine, case, sampled(proposed, count), None))

    def change(value: float) -> AbstractContextManager[object]:
        auxiliary_runs._arrange.cache_clear()
        return mock.patch("lmpchain.integrators.steps.MANY_STEPS", value)

    runs = [each for each in found if each]
    row = judge("MANY_STEPS", MANY_STEPS, (8, 16, 64, 128), change, runs, "9 to 65 steps a sample")
    auxiliary_runs._arrange.cache_clear()
    return row


if __name__ == "__main__":
    command(main, __doc__)
