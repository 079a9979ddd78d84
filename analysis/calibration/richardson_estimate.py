"""Measure the constants of the Richardson estimate of the error: SAFETY, ORDER_AT_OPENINGS and others.

Random scenes of every kind are run at three to four steps and the estimate is held against the true error, which comes
from the Taylor series in extended precision. What is asked of every constant is that 99 in 100 estimates are no smaller
than the true error. A factor is supported from there on up to half again what the worst estimate needs, or to where the
median one is five times the error. EVERY and EVERY_STRETCHED are supported where as many estimates are bounds as with
the best value, to one in two hundred.

    python analysis/calibration/richardson_estimate.py           # two to three minutes
    python analysis/calibration/richardson_estimate.py --quick   # seconds
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from unittest import mock

import numpy as np
from common import ALL_BUT_ONE, Case, Row, answer, command, proposal, quantile, with_reach
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines import companions
from lmpchain.engines.companions import (
    CLOSE_TO_OPENING,
    FEWEST,
    KINKED_BELOW,
    ORDER_AT_KINKS,
    ORDER_AT_OPENINGS,
    ORDER_WHERE_COARSE,
)
from lmpchain.engines.native import Native
from lmpchain.engines.richardson import SAFETY, extrapolate
from lmpchain.engines.time_stepping import REFINEMENT
from lmpchain.integrators import step_schedule
from lmpchain.integrators.methods import METHODS

MARGIN = 1.5  # over what the worst estimate needs, for scenes that were not drawn
LOOSE = 5.0  # times the true error: the largest median estimate
REACHES = (1.6, 0.8, 0.4, 0.2)  # omega h
KNOWN = 0.1  # errors above it obey no order
CLEAR = 30.0  # times round-off


@dataclass(frozen=True)
class Look:
    """One run: the differences from its companions at 2h and 4h, and the true error."""

    scene: int
    exponent: float
    order: int
    adaptive: bool
    reach: float
    lowest: float
    fine: float
    coarse: float
    error: float

    @property
    def opens(self) -> bool:
        """Whether a contact came close to opening, as the code says."""
        return self.lowest <= CLOSE_TO_OPENING

    def estimate(self, order: float, smooth: bool) -> float:
        """Return what `extrapolate` makes of it."""
        return extrapolate(order, smooth, self.coarse, self.fine)


def looks(cases: list[Case], name: str, adaptive: bool, coarse: bool = False) -> list[Look]:
    """Run the scenes at some steps; keep the runs whose errors are neither round-off nor out of all order."""
    found, method = [], METHODS[name]
    engine = Native(name, adaptive=adaptive)
    for number, case in enumerate(cases):
        if (
            proposed := proposal(engine, case.scene, 1e-3)
        ) is None or proposed.adaptive != adaptive:
            continue
        for reach in REACHES:
            if 4 * reach > method.stability_limit:
                continue
            candidate = with_reach(case.scene, proposed, reach)._replace(coarse_openings=coarse)
            if (run := answer(engine, case.scene, candidate)) is None:
                continue
            error = case.error(run.motion)
            if not CLEAR * run.error.roundoff + 10 * case.reference.error < error < KNOWN:
                continue
            exponent = case.scene.chain.exponent
            found.append(
                Look(
                    number,
                    exponent,
                    method.order,
                    adaptive,
                    reach,
                    run.lowest,
                    *run.differences[:2],
                    error,
                )
            )
    return found


def covered(found: list[Look], order: float, smooth: bool = True) -> float:
    """Return the part of the estimates that are no smaller than the true error."""
    return float(
        np.mean([look.estimate(min(order, look.order), smooth) >= look.error for look in found])
    )


def row_of_factor(
    name: str, shipped: float, found: list[Look], order: float, smooth: bool, what: str
) -> Row:
    """Return the row of a factor in front of an estimate."""
    needed = [
        look.error / look.estimate(look.order if smooth else order, smooth) * shipped
        for look in found
    ]
    low, most, middle = quantile(needed, ALL_BUT_ONE), max(needed), quantile(needed, 0.5)
    enough = np.mean(np.array(needed) <= shipped)
    says = (
        f"half need {middle:.2g}, 99 % {low:.2g}, all {most:.2g}; "
        f"{100 * enough:.1f} % of {len(found)} {what} are bounds"
    )
    return Row(name, shipped, low, low, max(MARGIN * most, LOOSE * middle), says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 8 if quick else 100
    calm = [
        case
        for case in map(Case, drawn(count, 2, lambda s: s.largest_strain < 0.3, strength=(-4, 0.0)))
        if case.known
    ]
    hard = [
        case
        for case in map(Case, drawn(count, 3, lambda s: s.largest_strain > 1, strength=(0.0, 3.0)))
        if case.known
    ]
    between = [
        case
        for case in map(
            Case, drawn(count, 5, lambda s: 0.3 < s.largest_strain < 3, strength=(-1.0, 1.0))
        )
        if case.known
    ]
    springy = [
        case
        for case in map(
            Case,
            drawn(
                count,
                4,
                lambda s: s.largest_strain > 1,
                strength=(0.0, 3.0),
                exponents=(1.0, 1.1, 1.2),
            ),
        )
        if case.known
    ]
    smooth = [
        look
        for name in ("verlet", "rkn4", "rkn6", "kahan-li6")
        for look in looks(calm, name, False)
    ]
    fixed = [look for name in ("rkn4", "rkn6") for look in looks(hard, name, False) if look.opens]
    steered = [
        look
        for name in ("rkn4", "rkn6", "kahan-li8")
        for look in looks(hard, name, True)
        if look.opens
    ]
    sprung = [
        look
        for name in ("rkn4", "rkn6", "kahan-li8")
        for look in looks(springy, name, True)
        if look.opens
    ]
    hertz = [look for look in steered if look.exponent >= KINKED_BELOW]
    coarse = [
        look
        for name in ("rkn4", "rkn6", "kahan-li8")
        for look in looks(hard, name, True, coarse=True)
    ]
    coarse = [look for look in coarse if look.opens and look.exponent >= KINKED_BELOW]
    rows = [row_of_factor("SAFETY", SAFETY, smooth, 0, True, "smooth runs")]

    factor = extrapolate(4, False, 0.0, 1.0)
    divisor = factor / extrapolate(4, False, 1.0, 0.0)
    rows.append(
        row_of_factor(
            "extrapolate: 1.5", factor, fixed, 0, False, "runs of fixed steps through openings"
        )
    )
    alone = [look.error / (factor * look.fine) for look in fixed if look.error > factor * look.fine]
    caught = {
        d: np.mean([factor * max(x.fine, x.coarse / d) >= x.error for x in fixed])
        for d in (1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0)
    }
    good = [d for d, part in caught.items() if part > ALL_BUT_ONE - 0.005] or [min(caught)]
    says = (
        f"{100 * caught[4.0]:.0f} % are bounds with it, {100 - 100 * len(alone) / max(1, len(fixed)):.0f} "
        "% without the run at 4h"
    )
    rows.append(Row("extrapolate: / 4", divisor, max(good), min(good), max(good), says))

    slopes = _orders(fixed)
    rows.append(
        Row(
            "StepRefinement.order_at_openings",
            REFINEMENT.order_at_openings,
            quantile(slopes, 0.5),
            quantile(slopes, 0.25),
            quantile(slopes, 0.75),
            "order of rkn6 with fixed steps through openings, Hertz, "
            f"{len(slopes)} scenes: median and quartiles; theory delta "
            "+ 1",
        )
    )
    for name, shipped, found, what in (
        (
            "ORDER_AT_OPENINGS",
            ORDER_AT_OPENINGS,
            hertz,
            f"adaptive runs, exponents from {KINKED_BELOW}",
        ),
        (
            "ORDER_WHERE_COARSE",
            ORDER_WHERE_COARSE,
            coarse,
            "the same where steps at openings are coarse",
        ),
        (
            "ORDER_AT_KINKS",
            ORDER_AT_KINKS,
            sprung,
            f"adaptive runs, exponents below {KINKED_BELOW}",
        ),
    ):
        parts = {order: covered(found, order) for order in (1, 2, 3, 4, 5, 6, 8)}
        most = max(
            (order for order, part in parts.items() if part > ALL_BUT_ONE - 0.005), default=1
        )
        listed = ", ".join(f"{order}: {100 * part:.0f}" for order, part in parts.items())
        rows.append(
            Row(
                name,
                shipped,
                most,
                1,
                most,
                f"% of {len(found)} {what} that are bounds at order {listed}",
            )
        )
    parts = {}
    for low, high in (
        (1.0, 1.0),
        (1.1, 1.1),
        (1.2, 1.2),
        (1.25, 1.25),
        (1.5, 1.5),
        (2.0, 2.0),
        (2.5, 3.0),
    ):
        found = [look for look in steered + sprung if low <= look.exponent <= high]
        if len(found) >= 5:
            parts[low] = covered(found, ORDER_AT_OPENINGS)
    failing = [delta for delta, part in parts.items() if part < ALL_BUT_ONE - 0.005]
    holding = [delta for delta in parts if delta > max(failing, default=1.0)]
    listed = ", ".join(f"{delta:g}: {100 * part:.0f}" for delta, part in parts.items())
    low, high = max(failing, default=1.0), min(holding, default=math.inf)
    rows.append(
        Row(
            "KINKED_BELOW",
            KINKED_BELOW,
            high,
            low,
            high,
            f"% of estimates of order {ORDER_AT_OPENINGS} that are bounds, by exponent: {listed}",
        )
    )
    rows += [_closeness(calm + between, quick), _fewest(count)]
    opening = (hard + springy)[:: 4 if quick else 2]
    rows += [_landings(opening, "rkn4", "EVERY"), _landings(opening, "dop853", "EVERY_STRETCHED")]
    return rows


def _landings(cases: list[Case], name: str, constant: str) -> Row:
    """Return the row of how many steps lie between two samples where companions land on each."""
    shipped, parts, runs = getattr(step_schedule, constant), {}, 0
    for value in sorted({8, 16, 32, 64, 128, 2**30, shipped}):
        bounds = []
        with mock.patch.object(step_schedule, constant, value):
            for case, steps in itertools.product(cases, (9, 17, 33, 65, 129)):
                engine = Native(name)
                if (proposed := proposal(engine, case.scene, 1e-3)) is None:
                    continue
                if (run := answer(engine, case.scene, proposed.sampled.with_steps(steps))) is None:
                    continue
                error = case.error(run.motion)
                if CLEAR * run.error.roundoff + 10 * case.reference.error < error < KNOWN:
                    bounds.append(run.error.total >= error)
        parts[value], runs = float(np.mean(bounds)), len(bounds)
    best = max(parts.values())
    good = [value for value, part in parts.items() if part > best - 0.005]
    listed = ", ".join(
        f"{value if value < 2**30 else 'none'}: {100 * part:.1f}" for value, part in parts.items()
    )
    says = f"% of {runs} estimates of {name} that are bounds, 9 to 129 steps between samples, by it: {listed}"
    return Row(
        constant, shipped, good[0], good[0], good[-1] if good[-1] < 2**30 else math.inf, says
    )


def _fewest(count: int) -> Row:
    """Return the row of FEWEST: from how many steps of a run on companions at 2h and 4h show its error."""
    short = drawn(
        2 * count, 6, lambda s: s.largest_strain < 0.3, strength=(-4.0, 0.0), spans=(0.5, 6.0)
    )
    cases = [
        case for scene in short if (case := Case(Scene(**scene.given() | {"samples": 2}))).known
    ]
    parts, runs = {}, 0
    for steps in (1, 2, 3, 4, 6, 8, 12, 16):
        bounds = []
        for case, name in itertools.product(cases, ("verlet", "rkn4", "rkn6", "kahan-li8")):
            proposed = proposal(engine := Native(name, adaptive=False), case.scene, 1e-3)
            if proposed is None:
                continue
            try:
                with mock.patch.object(companions, "FEWEST", 1):
                    run = answer(engine, case.scene, proposed.sampled.with_steps(steps))
            except ZeroDivisionError:  # the companions are alike
                bounds.append(False)
                continue
            if run is None or len(run.differences) < 2:
                continue
            # of one sample, which may be far below the largest motion
            error = float(
                (np.abs(run.motion - case.motion).max((1, 2)) / case.reference.scale).max()
            )
            if CLEAR * run.error.roundoff + 10 * case.reference.error < error < KNOWN:
                bounds.append(run.error.total >= error)
        if bounds:
            parts[steps], runs = float(np.mean(bounds)), runs + len(bounds)
    failing = [steps for steps, part in parts.items() if part < ALL_BUT_ONE - 0.005]
    first = min((steps for steps in parts if steps > max(failing, default=0)), default=math.inf)
    listed = ", ".join(f"{steps}: {100 * part:.0f}" for steps, part in parts.items())
    says = (
        f"% of {runs} estimates from 2h and 4h that are bounds, by the steps of the run: {listed}"
    )
    return Row("FEWEST", FEWEST, first, first, max(first, 4 * first), says)


def _orders(found: list[Look]) -> list[float]:
    """Return the observed orders of rkn6 between the longest and the shortest step of a scene, exponent 1.5."""
    orders = []
    for number in {look.scene for look in found}:
        mine = sorted(
            (x for x in found if x.scene == number and x.order == 6 and x.exponent == 1.5),
            key=lambda x: x.reach,
        )
        if len(mine) > 1 and mine[0].reach < mine[-1].reach:
            orders.append(
                math.log(mine[-1].error / mine[0].error) / math.log(mine[-1].reach / mine[0].reach)
            )
    return orders


def _closeness(cases: list[Case], quick: bool) -> Row:
    """Return the row of CLOSE_TO_OPENING: how low r / eps may fall while Richardson's estimate at fixed steps holds."""
    found = [look for look in looks(cases, "rkn6", False) if math.isfinite(look.fine)]
    edges, parts = (0.0, -0.25, -0.5, -0.75, -1.0, -1e9), {}
    for top, bottom in itertools.pairwise(edges):
        inside = [look for look in found if bottom < look.lowest <= top]
        if len(inside) >= (3 if quick else 8):
            parts[bottom] = float(
                np.mean([look.estimate(6, True) >= look.error for look in inside])
            )
    last = 0.0
    for bottom, part in parts.items():
        if part < ALL_BUT_ONE - 0.005:
            break
        last = max(bottom, -1.0)
    listed = ", ".join(f"{max(bottom, -2):g}: {100 * part:.0f}" for bottom, part in parts.items())
    says = f"% of smooth estimates that are bounds, by the lowest r / eps down to: {listed}"
    return Row("CLOSE_TO_OPENING", CLOSE_TO_OPENING, last, last, 0.0, says)


if __name__ == "__main__":
    command(main, __doc__)
