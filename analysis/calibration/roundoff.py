"""Measure round-off: of the native engine, of LAMMPS, which keeps heights, and of linear engines.

Runs at steps of rkn6 with omega h = 0.3 against the same steps in extended precision, so that only rounding is left;
of linear engines, chains of springs against the Taylor series in extended precision. A bound is supported from where
nine in ten runs stay below it up to ten times that; a typical value where it is within the middle half.

    python analysis/calibration/roundoff.py           # two minutes
    python analysis/calibration/roundoff.py --quick   # seconds
"""

from __future__ import annotations

import math

import numpy as np
from common import Case, Row, answer, command, quantile
from scenes import drawn

from lmpchain import Chain, Drive, Impulse, Scene
from lmpchain.engines.lammps.engine import HEIGHTS, Lammps, gauge_diameter
from lmpchain.engines.linear.engine import CANCELS, Chebyshev, LinearEngine, Modes
from lmpchain.engines.native import Native
from lmpchain.engines.native.round_off import ROUNDING, native_floor, plain_loss
from lmpchain.errors import InputError, ToleranceNotMet
from lmpchain.integrators.batch import STRONG, force_form
from lmpchain.integrators.kernels.contact_forces import ROOTS
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.splittings import RKN6
from lmpchain.simulation.api import simulate
from lmpchain.stability.roundoff import floor as predicted_floor
from lmpchain.stability.roundoff import measured_floor
from lmpchain.util.arrays import EPSILON

STEP = 0.3  # omega h


def gentle(count: int, seed: int, **ranges: object) -> list[Scene]:
    """Draw scenes that cannot be chaotic: short, unless weak, and nothing is driven."""
    return drawn(
        count, seed, **{"driven": 0.0, "grains": (2, 3, 5, 12, 30), "spans": (2.0, 15.0)} | ranges
    )


def evaluations(scene: Scene) -> int:
    """Return how often the force is evaluated at steps with omega h = 0.3."""
    intervals = scene.samples - 1
    return (
        RKN6.evaluations
        * intervals
        * math.ceil(scene.duration / intervals * scene.highest_frequency / STEP)
    )


def radians(scene: Scene) -> float:
    """Return the phase of the fastest motion at the end."""
    return scene.highest_frequency * scene.duration


def _native(count: int) -> Row:
    """Return the row of the random walk of the native engine: its factor, 1 in the code."""
    ratios = [
        measured_floor(scene, force="exact") / native_floor(evaluations(scene), radians(scene))
        for scene in gentle(count, 51)
    ]
    low, middle = quantile(ratios, 0.9), quantile(ratios, 0.5)
    shipped = native_floor(1e12, 0.0) / (EPSILON * 1e6)
    return Row(
        "native_floor",
        shipped,
        low,
        quantile(ratios, 0.25),
        10 * low,
        f"round-off over the floor: half {middle:.2g}, 9 in 10 {low:.2g}, most {max(ratios):.2g}",
    )


def _phases(count: int) -> Row:
    """Return the row of ROUNDING.phase: what rounding makes of long runs, less the random walk."""
    shifts = []
    for scene in gentle(
        count,
        57,
        strength=(-4.0, -0.5),
        kinds=("gravity", "load"),
        grains=(2, 3, 5),
        spans=(100.0, 500.0),
    ):
        walk = native_floor(evaluations(scene), 0.0)
        shifts.append(
            max(0.0, measured_floor(scene, force="exact") - walk) / (EPSILON * radians(scene))
        )
    middle, high = quantile(shifts, 0.5), quantile(shifts, 0.9)
    says = f"ulps of the phase in long runs: half {middle:.2g}, 9 in 10 {high:.2g}, most {max(shifts):.2g}"
    return Row("ROUNDING.phase", ROUNDING.phase, high, high, 10 * high, says)


def _flight(count: int) -> Row:
    """Return the row of ROUNDING.drift: two equal grains fly apart.

    The sum of their displacements is that of one at t = 0.
    """
    lost, rng = [], np.random.default_rng(61)
    chain, steps = Chain(grains=2, diameter=1e-3, gravity=0.0, bottom="free"), 10**5
    for name in ("verlet", "gear4", "rkn4", "rkn6"):
        for speed in 10 ** rng.uniform(-3, 0, count):
            stiff = chain.contact_constants[0] / (chain.masses[0] * speed**2)
            duration = 40 / (speed * stiff**0.4)
            scene = Scene(
                chain=chain, excitation=Impulse(velocity=speed), duration=duration, samples=2
            )
            run = simulate(scene, Native(name, duration / steps, adaptive=False))
            off = abs(run.displacement[-1].sum() / (speed * duration) - 1)
            lost.append(off / (EPSILON * run.cost.force_evaluations))
    middle, low, most = quantile(lost, 0.5), quantile(lost, 0.99), max(lost)
    says = f"last digits an evaluation in free flight: half {middle:.2g}, 99 % {low:.2g}, all {most:.2g} of {len(lost)}"
    return Row("ROUNDING.drift", ROUNDING.drift, low, low, 3 * low, says)


def _spread(count: int) -> list[Row]:
    """Return the rows of `spread` of every method: what its steps lose by the plain form, less by the exact one."""
    lost: dict[str, list[float]] = {name: [] for name in METHODS}
    for scene in gentle(
        count, 59, strength=(-4.0, -2.0), kinds=("gravity", "load"), exponents=(1.5,)
    ):
        if force_form(scene, "plain") not in ROOTS:
            continue
        for name in METHODS:
            step = scene.duration / evaluations(scene) * RKN6.evaluations * (1 + 1e-9)
            runs = [
                simulate(scene, Native(name, step, force=force, adaptive=False))
                for force in ("plain", "exact")
            ]
            apart = float(np.abs(runs[0].velocity - runs[1].velocity).max())
            lost[name].append(apart / plain_loss(scene, runs[0].cost.steps))
    rows = []
    for name, method in METHODS.items():
        low, middle, high = (quantile(lost[name], part) for part in (0.25, 0.5, 0.9))
        says = f"loss of the plain form over `plain_loss`: quarter, half, 9 in 10 {low:.2g}, {middle:.2g}, {high:.2g}"
        rows.append(Row(f"{name}.spread", method.spread, high, middle, 10 * high, says))
    return rows


def _bursts(count: int) -> Row:
    """Return the row of CANCELS: what rounding makes of tone bursts in eigenmodes, less the rest."""
    rng, losses = np.random.default_rng(60), []
    while len(losses) < count:
        chain = Chain(
            grains=int(rng.choice([3, 5, 12, 30])), diameter=1e-3, gravity=9.81, exponent=1.0
        )
        frequency = chain.band_edge / (2 * np.pi) * 10 ** rng.uniform(-3, 0.5)
        cycles = int(rng.choice([1, 3, 10]))
        drive = Drive(
            amplitude=1e-3 * chain.equilibrium_overlap[0], frequency=frequency, cycles=cycles
        )
        duration = 10 ** rng.uniform(-1.5, 0.3) * cycles / frequency
        case = Case(Scene(chain=chain, excitation=drive, duration=duration, samples=21))
        if not 0.5 < chain.band_edge * duration < 1000 or not case.known:
            continue
        run = answer(Modes(), case.scene, Modes().candidate(case.scene, 1.0))
        assert run
        wave = case.scene.excitation.waveform
        assert wave
        begun = min(1.0, wave.envelope * duration)
        law = EPSILON / begun**2 * (1 + chain.grains * wave.fastest / chain.band_edge)
        losses.append(
            max(0.0, case.error(run.motion) - Modes().round_off(case.scene) + CANCELS * law) / law
        )
    middle, low = quantile(losses, 0.5), quantile(losses, 0.9)
    says = f"bursts on springs, less the rest: half {middle:.2g}, 9 in 10 {low:.2g}, most {max(losses):.2g}"
    return Row("CANCELS", CANCELS, low, low, 30 * low, says)


def _plain(count: int) -> list[Row]:
    """Return the rows of ROUNDING.plain and STRONG: what the plain form of the force loses."""
    lost, strong = [], []
    ranges = {"kinds": ("gravity", "load"), "exponents": (1.5,)}
    for scene in gentle(count, 52, strength=(-4.0, -1.0), **ranges):
        if force_form(scene, "plain") not in ROOTS:
            continue
        law = predicted_floor(scene, force="plain") - native_floor(
            evaluations(scene), radians(scene) / 4
        )
        lost.append(ROUNDING.plain * measured_floor(scene, force="plain") / law)
    for scene in gentle(count, 53, strength=(math.log10(STRONG), 2.0), **ranges):
        strong.append(measured_floor(scene, force="plain") / measured_floor(scene, force="exact"))
    low, middle, high = (quantile(lost, part) for part in (0.25, 0.5, 0.9))
    most = quantile(strong, 0.9)
    return [
        Row(
            "ROUNDING.plain",
            ROUNDING.plain,
            middle,
            low,
            max(high, low),
            f"last digits lost a step by the plain form: quarter, half, 9 in 10 {low:.2g}, {middle:.2g}, {high:.2g}",
        ),
        Row(
            "STRONG",
            STRONG,
            STRONG if most < 10 else 10.0,
            0.0 if most < 10 else STRONG * 2,
            10.0 * STRONG,
            "round-off of the plain form over that of the exact one beyond "
            f"it: half {quantile(strong, 0.5):.2g}, 9 in 10 {most:.2g}",
        ),
    ]


def _lammps(count: int) -> list[Row]:
    """Return the rows of the random walk of LAMMPS: a bound, and what is typical."""
    ratios: list[float] = []
    for scene in gentle(count, 54, strength=(-4.0, 2.0), exponents=(1.5,)):
        if Lammps().refuses(scene):
            continue
        for diameter in ("physical", "gauge"):
            try:
                found = measured_floor(scene, "lammps", diameter)
            except (InputError, ToleranceNotMet):
                continue
            ratios.append(found / predicted_floor(scene, "lammps", diameter))
    walks = [HEIGHTS.typical * ratio for ratio in ratios]
    low, middle, high = (quantile(walks, part) for part in (0.25, 0.5, 0.75))
    nine = quantile(walks, 0.9)
    wide = quantile(np.exp(np.abs(np.log(ratios))), 0.9) if ratios else math.nan
    return [
        Row(
            "HEIGHTS.rounding",
            HEIGHTS.rounding,
            HEIGHTS.rounding * nine,
            HEIGHTS.rounding * nine,
            10 * HEIGHTS.rounding * nine,
            "ulp(height) sqrt(evaluations) that bound nine in ten of "
            f"{len(walks)} runs; half {HEIGHTS.rounding * middle:.2g}",
        ),
        Row(
            "HEIGHTS.typical",
            HEIGHTS.typical,
            middle,
            low,
            high,
            f"round-off over that bound: quartiles and median; nine in ten within a factor {wide:.2g} of it",
        ),
    ]


def _headroom(count: int) -> Row:
    """Return the row of HEIGHTS.headroom: overlaps of two neighbouring contacts over the bound on one."""
    needed = []
    for scene in gentle(count, 55, strength=(-2.0, 3.0), kinds=("gravity", "load", "vacuum")):
        part, engine = Scene(**scene.given() | {"samples": 201}), Native()
        try:
            run = simulate(part, engine, 1e-6)
        except ToleranceNotMet:
            continue
        u = run.displacement
        overlap = part.chain.contacts.overlap[1:-1] + u[:, :-1] - u[:, 1:]
        gauge = gauge_diameter(part)
        if gauge and overlap.shape[1] > 1:
            needed.append(
                float(
                    (np.maximum(overlap[:, 1:], 0) + np.maximum(overlap[:, :-1], 0)).max()
                    / gauge
                    * HEIGHTS.headroom
                )
            )
    low = max(needed, default=math.nan)
    return Row(
        "HEIGHTS.headroom",
        HEIGHTS.headroom,
        low,
        low,
        3 * low,
        "gauge diameter at which grain n + 2 is touched, over the "
        f"largest overlap; never above 2 by geometry; {len(needed)} "
        "scenes",
    )


def _linear(count: int) -> list[Row]:
    """Return the rows of the round-off of linear engines: factors of their laws, 1 in the code."""
    scenes = [
        Case(scene)
        for scene in gentle(
            count, 56, kinds=("gravity", "load"), exponents=(1.0,), strength=(-3.0, 0.0)
        )
    ]
    rows, engines = [], (Modes(), Chebyshev())
    for engine in engines:
        ratios = []
        for case in scenes:
            if isinstance(engine, LinearEngine) and not engine.refuses(case.scene) and case.known:
                run = answer(engine, case.scene, engine.candidate(case.scene, 1.0))
                assert run
                ratios.append(case.error(run.motion) / engine.round_off(case.scene))
        low = quantile(ratios, 0.9)
        rows.append(
            Row(
                f"{engine.name}.round_off",
                1.0,
                low,
                low,
                30 * low,
                f"error on springs over EPSILON (10 + omega T{' + 4 N' if engine.name == 'modes' else ''}): "
                f"half {quantile(ratios, 0.5):.2g}, 9 in 10 {low:.2g}",
            )
        )
    return rows


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 8 if quick else 60
    return [
        *(
            _native(count),
            _phases(count // 2),
            _flight(count),
            *_plain(count),
            *_spread(count // 2),
        ),
        *(*_lammps(count // 2), _headroom(count), *_linear(count), _bursts(count // 2)),
    ]


if __name__ == "__main__":
    command(main, __doc__)
