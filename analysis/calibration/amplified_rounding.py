"""Measure what rounding grows to where contacts open, and the constants with which an estimate allows for it.

Random scenes are run at ever shorter steps. Runs are rounding that the shortest steps of two methods hardly improve;
they are held against the Taylor series in extended precision. GROWN, STEADY and SHARED are supported from what 99 in
100 runs need of them for their estimate to be no smaller than the true error, the other parts being as they are, up to
what all of them need if the other parts were nothing. NEAR_ROUNDOFF, SHORT and GROWTH say which runs need no SHARED:
they are supported from the least that leaves out none, or one in a hundred, of the runs that do. COARSE and LONGER: the
growth of a small change in the coarse runs against that in two Taylor series; a value is supported if nine in ten are
above a third of it, as is how many DRAWS there are. SCATTER: the true error of such runs over a last digit grown, times
the last digits that rounding walks. BY_CHANCE: what is left of that error over what two runs differ by.

    python analysis/calibration/amplified_rounding.py           # three minutes
    python analysis/calibration/amplified_rounding.py --quick   # seconds
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from unittest import mock

import numpy as np
from common import (
    ALL_BUT_ONE,
    NINE_IN_TEN,
    Case,
    Row,
    answer,
    command,
    proposal,
    quantile,
    with_reach,
)
from scenes import drawn

from lmpchain import Scene
from lmpchain.benchmark.reference import reference
from lmpchain.engines import amplification, error_estimate
from lmpchain.engines.amplification import (
    COARSE,
    DRAWS,
    LAST_DIGIT,
    LONGER,
    amplified_digit,
    perturbed,
    walked,
)
from lmpchain.engines.base import Candidate
from lmpchain.engines.companions import CLOSE_TO_OPENING
from lmpchain.engines.error_estimate import (
    BY_CHANCE,
    GROWN,
    GROWTH,
    NEAR_ROUNDOFF,
    SCATTER,
    SHARED,
    SHORT,
    STEADY,
)
from lmpchain.engines.native import Native
from lmpchain.errors import RunFailed
from lmpchain.util.arrays import Array

REACHES = {
    "rkn6": (0.1, 0.05, 0.025),
    "kahan-li8": (0.2, 0.1, 0.05),
    "dop853": (0.2, 0.1, 0.05),
}  # omega h
MUCH = 1e-12, 1e-6  # of a last digit
KNOWN = 0.01  # errors and growths above it saturate
CHANGE = 1e-10  # of the Taylor series, far above what they round
ENOUGH = 1 / 3  # of the true growth
LEFT = 1 / 4  # of an error at the shortest steps of two methods, from which on it is rounding


@dataclass(frozen=True)
class Look:
    """One run: its true error, the parts of its estimate, and what becomes of a last digit.

    Attributes
    ----------
    extrapolated : float
        The Richardson estimate without GROWN and STEADY.
    difference : float
        Largest from the companion at 2h.
    floor : float
        The law of round-off, without SHARED.
    walk : float
        Last digits that rounding walks.
    """

    true: float
    extrapolated: float
    difference: float
    floor: float
    walk: float
    grown: float
    radians: float
    opens: bool

    @property
    def truncation(self) -> float:
        """The estimate of what the step makes."""
        return max(
            self.extrapolated, min(self.most, (GROWN if self.opens else STEADY) * self.floor)
        )

    @property
    def most(self) -> float:
        """The most that rounding is taken to make."""
        return self.difference * (BY_CHANCE if self.opens else 1.0)

    @property
    def raised(self) -> float:
        """By what that raises the estimate."""
        return (self.truncation + self.floor) / (self.extrapolated + self.floor)

    @property
    def shared(self) -> float:
        """The part of rounding that all runs share, where it is looked for."""
        likely = min(NEAR_ROUNDOFF, SHORT * math.exp(min(GROWTH * self.radians, 99)))
        return SHARED * self.grown if self.truncation + self.floor < likely else 0.0

    def differs(self, others: float) -> float:
        """Return the factor on round-off that this run needs, beside other parts; 0 if it needs none or none helps."""
        if (
            self.true <= self.extrapolated + self.floor + others
            or self.true > self.most + self.floor + others
        ):
            return 0.0
        return (self.true - self.floor - others) / self.floor

    def shares(self, truncation: float) -> float:
        """Return the factor on the grown last digit that this run needs, beside an estimate of the truncation."""
        return max(0.0, self.true - truncation - self.floor) / self.grown if self.grown else 0.0


def size(case: Case) -> Array:
    """Return the largest true displacement and velocity at any time, (2,)."""
    return case.reference.scale


def looks(case: Case) -> list[Look]:
    """Run a scene at short steps with several methods; keep the runs that no shorter steps improve much."""
    runs: list[list[Look | None]] = []
    for name, reaches in REACHES.items():
        if (proposed := proposal(Native(name), case.scene, 1e-9)) is not None:
            runs.append(
                [
                    look(case, Native(name), with_reach(case.scene, proposed, reach))
                    for reach in reaches
                ]
            )
    least = sorted(mine[-1].true for mine in runs if mine[-1])[1:2]
    return [
        run
        for mine in runs
        for run in mine
        if run and least and run.true < min(KNOWN, least[0] / LEFT)
    ]


def look(case: Case, engine: Native, candidate: Candidate) -> Look | None:
    """Hold one run against the truth; None if it breaks down, or has no companion with longer steps."""
    with mock.patch.multiple(error_estimate, GROWN=0.0, STEADY=0.0, NEAR_ROUNDOFF=0.0):
        run = answer(engine, case.scene, candidate)
    if run is None or len(run.differences) < 2:
        return None
    opens, radians = (
        run.lowest <= CLOSE_TO_OPENING,
        case.scene.highest_frequency * case.scene.duration,
    )
    true = float((np.abs(run.motion - case.motion).max((1, 2)) / size(case)).max())
    grown = amplified_digit(case.scene, size(case), run.steps) if opens else 0.0
    return Look(
        true,
        run.error.truncation,
        run.differences[0],
        run.error.roundoff,
        walked(run.evaluations),
        grown,
        radians,
        opens,
    )


def _factor(
    name: str, shipped: float, needs: list[tuple[float, float]], made: list[float], what: str
) -> Row:
    """Return the row of a factor: what is needed of it beside the other parts, and alone."""
    beside, alone = ([need[k] for need in needs] for k in (0, 1))
    low, most = quantile(beside, ALL_BUT_ONE), max(alone, default=math.nan)
    says = f"99 % of {len(needs)} {what} need {low:.2g}, without the other parts all {most:.2g}"
    return Row(
        name,
        shipped,
        low,
        low,
        max(low, most),
        f"{says}; doubles {sum(x > 2 for x in made)} estimates",
    )


def estimates(open_ones: list[Look], smooth: list[Look]) -> list[Row]:
    """Return the rows of the parts of the estimate, and of when the grown last digit is looked for."""
    missed = [x for x in open_ones if x.shares(x.extrapolated) > 0]
    worst = max((x.extrapolated + x.floor for x in missed), default=0.0)
    starts = [x.grown / math.exp(min(GROWTH * x.radians, 99)) for x in open_ones if x.grown]
    rates = [math.log(x.grown / SHORT) / x.radians for x in open_ones if x.grown]
    counted = f"of {len(open_ones)} runs, {len(missed)} of which need it"
    grown = [(x.differs(x.shared), x.differs(0.0)) for x in open_ones]
    steady = [(x.differs(0.0), x.differs(0.0)) for x in smooth]
    shared = [(x.shares(x.truncation), x.shares(x.extrapolated)) for x in open_ones]
    return [
        _factor("GROWN", GROWN, grown, [x.raised for x in open_ones], "open runs"),
        _factor("STEADY", STEADY, steady, [x.raised for x in smooth], "others"),
        _factor(
            "SHARED",
            SHARED,
            shared,
            [1 + x.shared / (x.truncation + x.floor) for x in open_ones],
            "open runs",
        ),
        Row(
            "NEAR_ROUNDOFF",
            NEAR_ROUNDOFF,
            worst,
            worst,
            math.inf,
            f"largest estimate that needs SHARED, {counted}",
        ),
        Row(
            "SHORT",
            SHORT,
            quantile(starts, ALL_BUT_ONE),
            quantile(starts, ALL_BUT_ONE),
            math.inf,
            f"what a digit grows to, less GROWTH: 99 % of {len(starts)} runs; all {max(starts, default=math.nan):.2g}",
        ),
        Row(
            "GROWTH",
            GROWTH,
            quantile(rates, ALL_BUT_ONE),
            quantile(rates, ALL_BUT_ONE),
            math.inf,
            f"exponent a radian beyond SHORT: 99 % of {len(rates)} runs; all {max(rates, default=math.nan):.2g}",
        ),
    ]


def growths(cases: Sequence[Case]) -> list[tuple[Case, float, int]]:
    """Return by what two Taylor series show a last digit to grow to, and the steps of an accurate run."""
    found = []
    for case in cases:
        try:
            other = reference(perturbed(case.scene, CHANGE))
        except RunFailed:
            continue
        apart = np.array([other.displacement, other.velocity]) - [
            case.reference.displacement,
            case.reference.velocity,
        ]
        grown = float((np.abs(apart).max((1, 2)) / size(case)).max())
        proposed = proposal(Native("rkn6"), case.scene, 1e-9)
        if proposed is None or not 100 * case.reference.error < grown < KNOWN:
            continue
        if (
            run := answer(Native("rkn6"), case.scene, with_reach(case.scene, proposed, 0.2))
        ) is not None:
            found.append((case, grown * LAST_DIGIT / CHANGE, run.steps))
    return found


def coarse(known: list[tuple[Case, float, int]]) -> list[Row]:
    """Return the rows of COARSE and LONGER: what coarse runs say of the growth, over the true one."""
    rows = []
    for name, shipped, values in (
        ("COARSE", COARSE, (2.0, 1.0, 0.5, 0.25, 0.1)),
        ("LONGER", LONGER, (64, 32, 16, 8, 4, 2)),
    ):
        parts, middles = {}, {}
        for value in values:
            alone = {"COARSE": math.inf, "LONGER": math.inf} | {name: value}
            with mock.patch.multiple(amplification, **alone):
                ratios = [
                    amplified_digit(case.scene, size(case), steps) / grown
                    for case, grown, steps in known
                ]
            parts[value] = (
                float(np.mean([ratio > ENOUGH for ratio in ratios])) if ratios else math.nan
            )
            middles[value] = quantile(ratios, 0.5)
        good = [value for value, part in parts.items() if part >= NINE_IN_TEN] or [min(values)]
        listed = ", ".join(
            f"{value:g}: {100 * part:.0f} % ({middles[value]:.2g})" for value, part in parts.items()
        )
        rows.append(
            Row(
                name,
                shipped,
                max(good),
                0.0,
                max(good),
                f"growths above a third of the true one (median over it), alone, {len(known)} scenes: {listed}",
            )
        )
    return rows


def draws(known: list[tuple[Case, float, int]]) -> Row:
    """Return the row of how many changes are tried."""
    every, parts = (*DRAWS, -0.5, 2.0, -2.0), {}
    for count in range(1, 1 + len(every)):
        with mock.patch.object(amplification, "DRAWS", every[:count]):
            ratios = [
                amplified_digit(case.scene, size(case), steps) / grown
                for case, grown, steps in known
            ]
        parts[count] = float(np.mean([ratio > ENOUGH for ratio in ratios]))
    good = [count for count, part in parts.items() if part >= NINE_IN_TEN] or [len(every)]
    listed = ", ".join(f"{count}: {100 * part:.0f} %" for count, part in parts.items())
    says = f"growths above a third of the true one, {len(known)} scenes, by how many changes are tried: {listed}"
    return Row("DRAWS (how many)", len(DRAWS), min(good), min(good), math.inf, says)


def scatter(open_ones: list[Look]) -> Row:
    """Return the row of SCATTER: the error where steps no longer help, over the grown last digits of the walk."""
    over = [x.shares(0.0) / x.walk for x in open_ones if x.grown]
    low, most = quantile(over, ALL_BUT_ONE), max(over, default=math.nan)
    says = f"error less the law of round-off, over the grown last digits of a walk: half {quantile(over, 0.5):.2g}"
    says += (
        f", 99 % {low:.2g}, all {most:.2g} of {len(over)} runs; bounded by what two runs differ by"
    )
    return Row("SCATTER", SCATTER, low, low, math.inf, says)


def chance(open_ones: list[Look]) -> Row:
    """Return the row of BY_CHANCE: the error where steps no longer help, over what two runs differ by."""
    over = [max(0.0, x.true - x.floor - x.shared) / x.difference for x in open_ones if x.difference]
    low, most = quantile(over, ALL_BUT_ONE), max(over, default=math.nan)
    says = f"error less round-off, over what two runs differ by: half {quantile(over, 0.5):.2g}, 99 % {low:.2g}"
    return Row(
        "BY_CHANCE", BY_CHANCE, low, low, math.inf, f"{says}, all {most:.2g} of {len(over)} runs"
    )


def amplifies(scene: Scene) -> bool:
    """Whether grains between walls make much of a last digit, but not all: those ask most of an estimate."""
    if not scene.chain.top == scene.chain.bottom == "wall":
        return False
    u, v = (float(np.abs(x).max()) for x in scene.excitation.largest(scene.chain))
    speed = max(v, u * scene.highest_frequency)
    return (
        MUCH[0]
        < amplified_digit(scene, np.array([speed / scene.highest_frequency, speed]), 1.0)
        < MUCH[1]
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count, spans, few = (3, (10.0, 30.0), (2, 3)) if quick else (16, (10.0, 120.0), (2, 3, 5))
    drawings = (
        drawn(count, 111, strength=(0.0, 3.0), spans=(2.0, 20.0), grains=few),
        drawn(count // 2, 114, amplifies, strength=(0.0, 3.0), spans=spans, grains=few),
        drawn(count // 2, 113, strength=(-4.0, 0.0), spans=(10.0, 60.0), grains=few),
    )
    cases = [case for scenes in drawings for case in map(Case, scenes) if case.known]
    found = [x for case in cases for x in looks(case)]
    opens, smooth = [x for x in found if x.opens], [x for x in found if not x.opens]
    open_cases = [case for case in cases if case.scene.largest_strain > 1]
    known = growths(open_cases)
    return [*estimates(opens, smooth), scatter(opens), chance(opens), *coarse(known), draws(known)]


if __name__ == "__main__":
    command(main, __doc__)
