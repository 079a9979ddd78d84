"""Adaptive steps and interpolated samples, compared with plain NumPy."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import plain_methods as plain
from helpers.flying_grains import flying, unlike
from helpers.plain_methods import WIDE, Motion
from helpers.thinned import thinned

from lmpchain import Chain, Drive, Force, Impulse, Law, Scene, simulate
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.methods import METHODS, RKN4, RKN6, Splitting
from lmpchain.integrators.observed_run import adaptive_steps
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import OPENING_STEPS, Steps

GRAINS = 7
LOOKS = 4
BETWEEN = {"top": "wall", "bottom": "wall", "top_material": "brass"}
EPSILON = np.finfo(float).eps


def flying_or_forced(acts: str = "", **options: Any) -> Scene:
    """Return a chain of flying grains, or of forced grains."""
    scene = flying(unlike(GRAINS, **options), 3, (0.5, 1.5), 10, LOOKS + 1)
    if not acts:
        return scene
    duration = scene.duration
    edge = 10 / duration
    scale = scene.chain.contacts.overlap.max()
    frequency = 0.4 * edge / (2 * np.pi)
    held = scene.chain.contacts.force.max()
    knots = np.array([0.0, 0.21, 0.44, 0.76, 1.1]) * duration
    bump = np.array([0.0, 1.0, -0.5, 0.8, 0.3])
    excitation = {
        "burst on grain 3": lambda: Force(
            amplitude=5 * held, frequency=frequency, cycles=0.3, grain=3
        ),
        "samples of the wall": lambda: Drive(times=knots, displacement=4 * scale * bump, grain=0),
        "sine of grain 1": lambda: Drive(amplitude=3 * scale, frequency=frequency),
    }[acts]()
    return scene.replace(excitation=excitation)


# Springs of the ground that grains reach at these displacements, and their stiffness.
PLACES = flying_or_forced().chain.contacts.overlap.max() * np.array(
    [0.3, -0.4, 1.0, -0.2, 0.1, 0.6, -0.7]
)
STOPS = float(flying_or_forced().chain.contacts.stiffness.max())
STOPPED = Law("k*max(s*u - e, 0)*s", k=STOPS, e=np.abs(PLACES).tolist(), s=np.sign(PLACES).tolist())


def stops(x: Any, t: Any) -> Any:
    """Return the force of the ground on every grain, N."""
    return STOPS * np.sign(PLACES) * np.maximum(np.abs(x) * np.sign(x * PLACES) - np.abs(PLACES), 0)


SCENES = {
    "3/2": flying_or_forced(),
    "2.3 between walls": flying_or_forced(exponent=2.3, **BETWEEN),
    "springs": flying_or_forced(exponent=1.0, **BETWEEN),
    "touching wall": flying_or_forced(top_load=0.0, **BETWEEN),
    "vacuum": flying_or_forced(top_load=0.0, gravity=0.0, **BETWEEN),
    "loose grains": flying_or_forced(gravity=0.0, load_grain=3),
    "ground": flying_or_forced(ground=STOPPED),
    "burst on grain 3": flying_or_forced("burst on grain 3", **BETWEEN),
    "formula": flying_or_forced(law=Law("k*max(o, 0)**p", p=[1.5] * (GRAINS - 1))),
    "sine of grain 1": flying_or_forced("sine of grain 1"),
    "samples of the wall": flying_or_forced("samples of the wall", **BETWEEN),
}


def kinks(scene: Scene) -> np.ndarray:
    """Return the times at which the forcing changes its formula and steps end, s."""
    if not scene.excitation.does_work:
        return np.empty(0)
    return np.array(scene.excitation.waveform.kinks)


def time_to_opening(gap: float, rate: float, bend: float) -> float:
    """Return the distance to the nearest complex root of a quadratic.

    For an open contact the root must lie ahead.
    """
    roots = (
        np.roots([bend / 2, rate, gap]) if bend else np.roots([rate, gap]) if rate else np.empty(0)
    )
    if gap <= 0:
        roots = roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(np.abs(roots).min()) if roots.size else np.inf


def score(gap: float, rate: float, bend: float, weight: float, omega: float, cap: float) -> float:
    """Return the nearness (weight)^2 size^(3/2) / (omega distance)^9 of one kink."""
    distance = time_to_opening(gap, rate, bend)
    fast = 2 * abs(gap) / distance if distance else 2 * max(rate, 0.0)
    fast = max(fast, abs(bend) / (2 * omega * cap)) if gap >= 0 else fast
    size = max(abs(rate**2 - 2 * gap * bend), fast**2 / 32)
    near = min(cap, fast / (2 * omega * abs(gap)) if gap else np.inf * bool(fast))
    return float(weight * size**1.5 * near**9)


def nearness(
    scene: Scene, motion: Motion, x: Any, v: Any, t: Any, cap: float, speed: float
) -> float:
    """Return the largest nearness of all contacts, and of all stops of a ground.

    `speed` is the scale of the velocities.
    """
    chain = scene.chain
    omega = scene.highest_frequency
    bodies = np.zeros((3, GRAINS + 2))
    bodies[0, 1:-1] = x
    bodies[1, 1:-1] = v
    bodies[2, 1:-1] = motion.acceleration(x, t)
    if motion.driven:
        bodies[0, 1] = motion.course(t, 0)
        bodies[1, 1] = motion.course(t, 1)
    elif motion.wall:
        bodies[0, 0] = motion.course(t, 0)
        bodies[1, 0] = motion.course(t, 1)
    r, rates, bends = bodies[:, :-1] - bodies[:, 1:]
    compressed = chain.compressed
    free = np.concatenate(([0], motion.mobile.astype(float) / chain.masses, [0]))
    mobility = np.maximum(free[:-1], free[1:])
    largest = 0.0
    for n in range(GRAINS + 1):
        constant = chain.contacts.constant[n]
        force = chain.contacts.force[n]
        if constant == 0:
            continue
        pressed = compressed and force > 0
        length = chain.contacts.overlap[n] if pressed else 1.0
        gap = float(r[n] / length) + pressed
        rate = float(rates[n] / length)
        bend = float(bends[n] / length)
        typical = (speed / (omega * length)) ** (chain.exponent - 1.5)
        pull = (force if pressed else constant) * typical
        weight = (pull * mobility[n] / (omega**2.5 * speed)) ** 2
        largest = max(largest, score(gap, rate, bend, weight, omega, cap))
    # The slope of the force changes by STOPS at the kink, for the scale of the motion.
    typical = speed / omega
    for n, place in enumerate(PLACES if chain.ground else ()):
        pull = STOPS * typical * (typical / abs(place)) ** -1.5
        weight = (pull * free[n + 1] / (omega**2.5 * speed)) ** 2
        moved = (float(row[n + 1]) / -place for row in bodies)
        gap, rate, bend = moved
        largest = max(largest, score(1 + gap, rate, bend, weight, omega, cap))
    return largest


def motion_of(scene: Scene) -> Motion:
    motion = Motion(plain.column_of(scene))
    motion.ground = stops if scene.chain.ground else None
    return motion


def by_dop853(motion: Motion, method: Any, steps: list[Any]) -> np.ndarray:
    """Return the states after steps of DOP853."""
    return plain.by_dormand_prince(motion, steps)


@cache
def adapted_3_2() -> tuple[list[Any], np.ndarray, list[int]]:
    """Return the result of `adapted` for the power 3/2, which a formula shares."""
    return adapted(SCENES["3/2"], RKN6, 6)


def adapted(scene: Scene, method: Any, each: int) -> tuple[list[Any], np.ndarray, list[int]]:
    """Return all steps, the states between them, and the number of states before each sample."""
    motion = motion_of(scene)
    x, v = motion.x, motion.v
    t = WIDE(0)
    longest = scene.duration / LOOKS / each
    omega = scene.highest_frequency
    speed = ChainBatch([scene]).arrays.scale[0, 1]
    # The slope of the force from the ground jumps.
    falls = 1 / ((1 if scene.chain.ground else scene.chain.exponent) + 1)
    crossing = OPENING_STEPS.crossing ** (2.5 * falls)
    crosses = crossing * (omega * longest) ** ((method.order + 1) * falls)
    crosses = max(crosses, OPENING_STEPS.least_crossing * EPSILON**falls)
    shortened = OPENING_STEPS.shortened
    cap = (shortened * omega * longest / crosses) ** (14 / 9)
    steps: list[Any] = []
    states = [motion.seen(x, v, t)]
    made = [0]
    for look in range(LOOKS):
        end = (look + 1) * WIDE(scene.duration) / LOOKS
        ends = [c for c in kinks(scene) if t + 1e-6 * longest < c < end - 1e-6 * longest]
        for until in [*ends, end]:
            while until - t > 1e-9 * longest:
                near = nearness(scene, motion, x, v, t, cap, speed)
                h = longest * min(1.0, shortened * near ** (-1 / 14)) if near > 0 else longest
                step = (until - t) / max(1, np.ceil(float((until - t) / h) - 1e-9))
                one = motion_of(scene)
                one.x = x
                one.v = v
                one.course = motion.course and (
                    lambda time, *how, begun=t: motion.course(begun + time, *how)
                )
                march = plain.by_splitting if isinstance(method, Splitting) else by_dop853
                x, v = march(one, method, [step])[1]
                if motion.driven:
                    v[0] = 0
                t = t + step
                steps.append(step)
                states.append(motion.seen(x, v, t))
        made.append(len(steps))
    return steps, np.array(states), made


def native(scene: Scene, method: Any, each: int, most: int) -> tuple[int, np.ndarray]:
    """Return the number of steps, and all samples (2, LOOKS+1, N) but the first one."""
    schedule = Steps(each, 1, scene.duration / LOOKS / each, True)
    stepper = NativeStepper(ChainBatch([scene]), method, schedule, {})
    fields = np.zeros((2, 1, LOOKS + 1, GRAINS))
    while stepper.sample < LOOKS:
        stepper.fill(*fields, 0, LOOKS, most)
    return stepper.steps[0], fields[:, 0, 1:]


def distance(fields: np.ndarray, states: np.ndarray, made: list[int]) -> float:
    """Return the largest distance of samples from those of plain NumPy, over the largest value."""
    true = states[made[1:]].swapaxes(0, 1)
    return float((np.abs(fields - true).max((1, 2)) / np.abs(true).max((1, 2))).max())


@pytest.mark.parametrize("name", thinned(SCENES, 2))
def test_steps_shorten_where_contacts_open_as_in_plain_numpy(name: str):
    scene = SCENES[name]
    method = RKN4 if name == "springs" else RKN6
    # The formula states the power 3/2.
    shared = name in ("3/2", "formula")
    steps, states, made = adapted_3_2() if shared else adapted(scene, method, 6)
    count, fields = native(scene, method, 6, 3)
    assert count == len(steps) > 6 * LOOKS + (name != "sine of grain 1")
    assert distance(fields, states, made) < 1e-11
    parts = adaptive_steps(scene, method, scene.duration / LOOKS / 6 * 1.01, LOOKS)
    assert [part.size for part in parts] == np.diff(made).tolist()
    assert np.concatenate(parts) == pytest.approx(np.array(steps, dtype=float), rel=1e-9)
    sums = [part.sum() for part in parts]
    assert sums == pytest.approx(np.full(LOOKS, scene.duration / LOOKS), rel=1e-14)


OPENING = ["2.3 between walls", "touching wall", "loose grains"]
FORCED = ["burst on grain 3", "samples of the wall", "sine of grain 1"]


@pytest.mark.parametrize("name", [*OPENING, *FORCED])
def test_dop853_shortens_its_steps_where_contacts_open_as_in_plain_numpy(name: str):
    method = METHODS["dop853"]
    steps, states, made = adapted(SCENES[name], method, 3)
    count, fields = native(SCENES[name], method, 3, 2)
    assert count == len(steps)
    assert distance(fields, states, made) < 1e-9


@pytest.mark.parametrize("stride", [4, 3])
@pytest.mark.parametrize(
    "name", [name for name in SCENES if not SCENES[name].excitation.does_work and name != "ground"]
)
def test_samples_between_steps_are_on_a_polynomial_of_degree_7(name: str, stride: int):
    """The polynomial has the exact values, velocities, accelerations and jerks at both ends."""
    scene = SCENES[name].replace(samples=4 * LOOKS + 1)
    steps = 10
    dense = 2 if stride == 4 else 1
    interval = scene.duration / (4 * LOOKS)
    schedule = Steps(steps, stride, stride * interval / steps, True, dense=dense)
    stepper = NativeStepper(ChainBatch([scene]), RKN6, schedule, {})
    fields = np.full((2, 1, 4 * LOOKS + 1, GRAINS), np.nan)
    # Both strides land on sample 12, where the next block begins.
    stepper.fill(*fields[:, :, :13], 0, 12, 2**62)
    stepper.fill(*fields[:, :, 13:], 13, 4 * LOOKS, 2**62)
    fine = scene.replace(samples=4 * LOOKS + 1)
    each = NativeStepper(ChainBatch([fine]), RKN6, Steps(40, 1, interval / 40, True), {})
    true = np.zeros((2, 1, 4 * LOOKS + 1, GRAINS))
    each.fill(*true, 0, 4 * LOOKS, 2**62)
    samples = np.arange(1, 4 * LOOKS + 1)
    landed = [n for n in samples if n % stride == 0 or n == 4 * LOOKS or (n % stride) % dense == 0]
    known = ~np.isnan(fields[0, 0]).any(1)
    assert np.flatnonzero(known).tolist() == landed
    between = [n for n in landed if n % stride and n != 4 * LOOKS]
    scale = np.abs(true).max((1, 2, 3))
    for order in (0, 1):
        error = np.abs(fields[order, 0] - true[order, 0])[between].max() / scale[order]
        assert error < 1e-9


@pytest.mark.parametrize("exponent", [1.75, 2.5])
def test_steps_in_the_vacuum_do_not_depend_on_the_unit_of_length(exponent: float):
    """A strike at another speed is the same motion in different units."""
    chain = Chain(grains=4, diameter=1e-3, exponent=exponent, gravity=0.0, bottom="wall")
    steps = set()
    for speed in (1e-4, 0.1):
        scene = Scene(chain=chain, excitation=Impulse(velocity=speed), duration=1e-6, samples=2)
        scene = scene.replace(duration=30 / scene.highest_frequency)
        steps.add(simulate(scene, "native", 1e-8).cost.steps)
    assert len(steps) == 1
