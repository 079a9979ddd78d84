"""Measure rounding errors of the native engine, of heights in LAMMPS, and of linear engines.

Runs at steps of rkn6 with omega h = 0.3 against the same steps in extended precision, so that only
rounding is left; of linear engines, chains of springs against the Taylor series in extended
precision. A bound is supported from where nine in ten runs stay below it up to ten times that; a
typical value where it is within the middle half.

    python analysis/calibration/roundoff.py           # two minutes
    python analysis/calibration/roundoff.py --quick   # seconds
"""

from __future__ import annotations

import math

import numpy as np
from common import Case, Row, answer, command, quantile
from scenes import drawn

from lmpchain import Chain, Drive, Force, Impulse, Scene
from lmpchain.engines.lammps.engine import HEIGHTS, Lammps, gauge_diameter
from lmpchain.engines.linear.engine import CANCELS, Chebyshev, LinearEngine, Modes
from lmpchain.engines.native import Native
from lmpchain.engines.stepping.rounding import ROUNDING, native_floor, plain_loss, reduced_loss
from lmpchain.errors import InputError, ToleranceNotMet
from lmpchain.integrators.batch import STRONG, force_form
from lmpchain.integrators.kernels.contact_forces import ROOTS
from lmpchain.integrators.methods import METHODS, RKN6
from lmpchain.simulation.api import simulate
from lmpchain.stability.roundoff import floor as predicted_floor
from lmpchain.stability.roundoff import measured_floor
from lmpchain.util.arrays import EPSILON

STEP = 0.3  # Value of omega h.


def gentle(count: int, seed: int, **ranges: object) -> list[Scene]:
    """Draw scenes without chaos: short unless weak, and without forcing."""
    return drawn(
        count, seed, **{"driven": 0.0, "grains": (2, 3, 5, 12, 30), "spans": (2.0, 15.0)} | ranges
    )


def evaluations(scene: Scene) -> int:
    """Return the number of force evaluations at steps with omega h = 0.3."""
    intervals = scene.samples - 1
    return (
        RKN6.evaluations
        * intervals
        * math.ceil(scene.duration / intervals * scene.highest_frequency / STEP)
    )


def radians(scene: Scene) -> float:
    """Return the total phase of the fastest motion."""
    return scene.highest_frequency * scene.duration


def bound(
    name: str, shipped: float, values: list[float], what: str, wide: float = 10.0, part: float = 0.9
) -> Row:
    """Return the row of a bound.

    Supported from where so many runs stay below it to so many times that.
    """
    middle, low, most = (quantile(values, share) for share in (0.5, part, 1.0))
    says = (
        f"{what}, {len(values)} runs: half {middle:.2g}, {100 * part:g} % {low:.2g}, all {most:.2g}"
    )
    return Row(name, shipped, low, low, wide * low, says)


def typical(
    name: str, shipped: float, values: list[float], what: str, high: float = 0.75, wide: float = 1.0
) -> Row:
    """Return the row of a typical value, which a quarter of the runs must exceed."""
    low, middle, most = (quantile(values, share) for share in (0.25, 0.5, high))
    says = (
        f"{what}, {len(values)} runs: quarter {low:.2g}, half {middle:.2g}, {100 * high:g} % "
        f"{most:.2g}"
    )
    return Row(name, shipped, middle, low, wide * most, says)


def _native(count: int) -> Row:
    """Return the row of the native engine's random walk: its factor, 1 in the code."""
    ratios = [
        measured_floor(scene, force="exact") / native_floor(evaluations(scene), radians(scene))
        for scene in gentle(count, 51)
    ]
    shipped = native_floor(1e12, 0.0) / (EPSILON * 1e6)
    return typical("native_floor", shipped, ratios, "round-off over the floor", 0.9, 10.0)


def _phases(count: int) -> Row:
    """Return the row of ROUNDING.phase: rounding of long runs in excess of the random walk."""
    weak = {"strength": (-4.0, -0.5), "kinds": ("gravity", "load"), "grains": (2, 3, 5)}
    shifts = []
    for scene in gentle(count, 57, spans=(100.0, 500.0), **weak):
        walk = native_floor(evaluations(scene), 0.0)
        left = max(0.0, measured_floor(scene, force="exact") - walk)
        shifts.append(left / (EPSILON * radians(scene)))
    return bound("ROUNDING.phase", ROUNDING.phase, shifts, "last digits of the phase")


def _flight(count: int) -> Row:
    """Return the row of ROUNDING.drift, from two equal grains that fly apart.

    The sum of their displacements is that of one at t = 0.
    """
    lost = []
    rng = np.random.default_rng(61)
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, bottom="free")
    steps = 10**5
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
    return bound("ROUNDING.drift", ROUNDING.drift, lost, "last digits in free flight", 3.0, 0.99)


def _creeping(count: int) -> Row:
    """Return the row of ROUNDING.reduced, from slowly loaded damped springs."""
    lost = []
    rng = np.random.default_rng(62)
    while len(lost) < count:
        chain = Chain(
            grains=int(rng.integers(2, 9)), diameter=1e-3, exponent=1.0, gravity=0.0, top_load=1.0
        )
        omega = chain.band_edge
        viscous, drag = 10 ** rng.uniform(0, 1, 2) * (rng.random(2) < 0.7)
        damping = {"viscoelastic": viscous / omega, "drag": drag * omega}
        duration = 10 ** rng.uniform(1.3, 2) / omega
        force = Force(amplitude=1e-3, frequency=rng.uniform(0.05, 3) / duration)
        damped = chain.replace(damping=damping)
        case = Case(Scene(chain=damped, excitation=force, duration=duration, samples=11))
        if not damped.damped or not case.known:
            continue
        engine = Native(step=0.3 / damped.fastest_rate)
        run = answer(engine, case.scene, engine.propose(case.scene, 1.0))
        assert run
        displacement, speed = (float(np.abs(field).max()) for field in run.motion)
        loss = reduced_loss(case.scene, displacement, 0.0) / speed
        if loss > 100 * EPSILON:
            lost.append(ROUNDING.reduced * case.error(run.motion) / loss)
    return bound("ROUNDING.reduced", ROUNDING.reduced, lost, "last digits of damped springs")


def _spread(count: int) -> list[Row]:
    """Return the rows of `spread` of every method.

    What its steps lose by the plain form, less by the exact one.
    """
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
    what = "loss of the plain form over `plain_loss`"
    return [
        typical(f"{name}.spread", method.spread, lost[name], what, 0.9, 10.0)
        for name, method in METHODS.items()
    ]


def _bursts(count: int) -> Row:
    """Return the row of CANCELS.

    What rounding makes of tone bursts in eigenmodes, less the rest.
    """
    rng = np.random.default_rng(60)
    losses = []
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
        run = answer(Modes(), case.scene, Modes().propose(case.scene, 1.0))
        assert run
        wave = case.scene.excitation.waveform
        assert wave
        begun = min(1.0, wave.envelope * duration)
        law = EPSILON / begun**2 * (1 + chain.grains * wave.fastest / chain.band_edge)
        losses.append(
            max(0.0, case.error(run.motion) - Modes().round_off(case.scene) + CANCELS * law) / law
        )
    return bound("CANCELS", CANCELS, losses, "bursts on springs, less the rest", 30.0)


def _plain(count: int) -> list[Row]:
    """Return the rows of ROUNDING.plain and STRONG: the loss of the plain form of the force."""
    lost = []
    strong = []
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
    most = quantile(strong, 0.9)
    first = STRONG if most < 10 else 2 * STRONG
    says = f"round-off of the plain form over that of the exact one beyond it: 9 in 10 {most:.2g}"
    return [
        typical("ROUNDING.plain", ROUNDING.plain, lost, "last digits a step", 0.9),
        Row("STRONG", STRONG, first, first, 10.0 * STRONG, says),
    ]


def _lammps(count: int) -> list[Row]:
    """Return the rows of the random walk in LAMMPS: an upper bound and a typical value."""
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
    bounds = [HEIGHTS.rounding * walk for walk in walks]
    return [
        bound("HEIGHTS.rounding", HEIGHTS.rounding, bounds, "ulp(height) sqrt(evaluations)"),
        typical("HEIGHTS.typical", HEIGHTS.typical, walks, "round-off over that bound"),
    ]


def _headroom(count: int) -> Row:
    """Return the row of HEIGHTS.headroom.

    Overlaps of two neighbouring contacts over the bound on one.
    """
    needed = []
    for scene in gentle(count, 55, strength=(-2.0, 3.0), kinds=("gravity", "load", "vacuum")):
        part = Scene(**scene.given() | {"samples": 201})
        engine = Native()
        try:
            run = simulate(part, engine, 1e-6)
        except ToleranceNotMet:
            continue
        u = run.displacement
        overlap = part.chain.contacts.overlap[1:-1] + u[:, :-1] - u[:, 1:]
        gauge = gauge_diameter(part)
        if gauge and overlap.shape[1] > 1:
            pairs = np.maximum(overlap[:, 1:], 0) + np.maximum(overlap[:, :-1], 0)
            needed.append(float(pairs.max() / gauge * HEIGHTS.headroom))
    what = "diameter at which grain n + 2 is touched, over the largest overlap; 2 by geometry"
    return bound("HEIGHTS.headroom", HEIGHTS.headroom, needed, what, 3.0, 1.0)


def _linear(count: int) -> list[Row]:
    """Return the rows of rounding in linear engines: factors of their laws, 1 in the code."""
    scenes = [
        Case(scene)
        for scene in gentle(
            count, 56, kinds=("gravity", "load"), exponents=(1.0,), strength=(-3.0, 0.0)
        )
    ]
    rows = []
    engines = (Modes(), Chebyshev())
    for engine in engines:
        ratios = []
        for case in scenes:
            if isinstance(engine, LinearEngine) and not engine.refuses(case.scene) and case.known:
                run = answer(engine, case.scene, engine.propose(case.scene, 1.0))
                assert run
                ratios.append(case.error(run.motion) / engine.round_off(case.scene))
        what = "error on springs over its law"
        rows.append(bound(f"{engine.name}.round_off", 1.0, ratios, what, 30.0))
    return rows


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 8 if quick else 60
    few = count // 2
    native = [
        _native(count),
        _phases(few),
        _flight(count),
        _creeping(few),
        *_plain(count),
        *_spread(few),
    ]
    return [*native, *_lammps(few), _headroom(count), *_linear(count), _bursts(few)]


if __name__ == "__main__":
    command(main, __doc__)
