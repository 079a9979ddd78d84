"""Every compiled method against plain NumPy, step by step, for every law, end and excitation."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers import plain_methods as plain
from helpers.example_chains import column
from helpers.example_scenes import scene_of, stirred
from helpers.flying_grains import flying as flying_grains
from helpers.flying_grains import forcings, unlike
from helpers.plain_methods import WIDE, Motion

from lmpchain import Chain, Drive, Force, Law, Profile, Scene
from lmpchain.integrators.batch import ChainBatch, name_of
from lmpchain.integrators.kernels.layout import PAD
from lmpchain.integrators.kernels.right_hand_side import TILE
from lmpchain.integrators.methods import METHODS, SPLITTINGS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

GRAINS = 7


def pressed(**options: Any) -> Chain:
    return unlike(GRAINS, **options)


BETWEEN = {"top": "wall", "bottom": "wall", "top_material": "brass"}
BASE = {"bottom": "wall"}
VACUUM = {"gravity": 0.0, "top_load": 0.0}
TOUCHING = {"top_load": 0.0} | BETWEEN
LOOSE = {"gravity": 0.0, "load_grain": 4} | BASE
ROOT, ROOTS, POWER = "corrected square root", "plain square roots", "vectorised power"
# Strains, option and name of the form of the force, exponent, and other options of the chain.
LAWS: dict[str, tuple[float, str, str, float, dict[str, Any]]] = {
    "corrected": (1.0, "exact", ROOT, 1.5, {}),
    "corrected, weak": (0.03, "exact", ROOT, 1.5, BETWEEN),
    "polynomial": (1e-4, "auto", "polynomial", 1.5, {}),
    "polynomial, 2.3": (1e-3, "auto", "polynomial", 2.3, BETWEEN),
    "springs": (2.0, "auto", "spring", 1.0, BETWEEN),
    "5/4": (4.0, "plain", ROOTS, 1.25, BETWEEN),
    "3/2": (4.0, "auto", ROOTS, 1.5, BETWEEN),
    "7/4": (4.0, "plain", ROOTS, 1.75, {}),
    "2": (4.0, "plain", ROOTS, 2.0, BASE),
    "2.3": (1.0, "auto", POWER, 2.3, BASE),
    "vacuum": (1.0, "auto", ROOTS, 1.5, VACUUM | BETWEEN),
    "vacuum, free": (1.0, "auto", ROOTS, 1.5, VACUUM | {"bottom": "free"}),
    "vacuum, springs": (1.0, "auto", "spring", 1.0, VACUUM),
    "vacuum, 3": (1.0, "auto", POWER, 3.0, VACUUM | {"top": "wall"}),
    "touching wall": (1.0, "exact", ROOT, 1.5, TOUCHING),
    "touching wall, 2": (3.0, "plain", ROOTS, 2.0, TOUCHING),
    "touching wall, 2.3": (3.0, "auto", POWER, 2.3, TOUCHING),
    "touching wall, 1": (3.0, "auto", "spring", 1.0, TOUCHING),
    "loose grains": (1.0, "auto", ROOTS, 1.5, LOOSE),
    "loose grains, weak": (0.03, "exact", POWER, 1.5, LOOSE),
}


def flying(law: str) -> Scene:
    """Return a scene of moving grains whose contacts differ from rest by some overlaps."""
    strains, _, _, exponent, options = LAWS[law]
    chain = pressed(exponent=exponent, **options)
    return flying_grains(chain, 3, (strains / 2, strains), 6, 5)


ACTED = pressed(**BETWEEN)
ACTS = forcings(ACTED, 12)
HELD = float(ACTED.contacts.force.max())
STEPS_EACH = 12  # Number of steps between samples.


def acted(name: str) -> Scene:
    return scene_of(ACTED, ACTS[name], 12 / ACTED.band_edge, 5)


def answer(
    scene: Scene, method: str, schedule: Steps, force: str = "auto"
) -> tuple[np.ndarray, NativeStepper]:
    """Return displacements and velocities (2, T, N), computed in pieces of a few steps."""
    stepper = NativeStepper(ChainBatch([scene], force), METHODS[method], schedule, {})
    fields = np.zeros((2, 1, scene.samples, scene.chain.grains))
    fields[:, 0, 0] = scene.initial()
    while stepper.sample < scene.samples - 1:
        stepper.fill(*fields, 0, scene.samples - 1, 5)
    return fields[:, 0], stepper


def kinks(scene: Scene, method: str) -> list[float]:
    """Return the times at which the forcing changes and a method ends a step, s."""
    waveform = scene.excitation.waveform if scene.excitation.does_work else None
    if waveform is None or method == "verlet":
        return []
    if waveform.spline is not None:
        return list(scene.excitation.times) if method == "dop853" else []
    return [waveform.end]


def steps_of(scene: Scene, method: str, steps: int) -> tuple[list[Any], list[int]]:
    """Return the lengths of all steps, and the number of steps before each sample."""
    lengths: list[Any] = []
    made = [0]
    time = np.linspace(WIDE(0), WIDE(scene.duration), scene.samples)
    for begin, end in pairwise(time):
        h = (end - begin) / steps
        grid = begin + h * np.arange(steps + 1)
        cuts = [t for t in kinks(scene, method) if begin + 1e-6 * h < t < end - 1e-6 * h]
        if method == "dop853":  # Steps are equal parts between kinks.
            for left, right in pairwise([begin, *cuts, end]):
                count = int(np.ceil((right - left) / h - 1e-9))
                lengths += [(right - left) / count] * count
        else:
            lengths += list(np.diff(np.sort(np.concatenate((grid, np.array(cuts, dtype=WIDE))))))
        made.append(len(lengths))
    return lengths, made


def plainly(scene: Scene, method: str, steps: int, ground: Any = None) -> np.ndarray:
    """Return the displacement and velocity from plain NumPy, (2, T, N).

    `ground` is a function of displacements and time, which returns the force of a ground.
    """
    motion = Motion(plain.column_of(scene))
    motion.ground = ground
    (lengths, made) = steps_of(scene, method, steps)
    if method == "dop853":
        states = plain.by_dormand_prince(motion, lengths)
    elif method == "gear4":
        states = plain.by_gear(motion, lengths)
    else:
        states = plain.by_splitting(motion, SPLITTINGS[method], lengths)
    return states[made].swapaxes(0, 1)


def distance(fields: np.ndarray, others: np.ndarray) -> float:
    """Return the largest distance of two solutions over the largest displacement and velocity."""
    return float((np.abs(fields - others).max((1, 2)) / np.abs(others).max((1, 2))).max())


@pytest.mark.parametrize("method", ["verlet", "rkn6", "dop853", "gear4"])
@pytest.mark.parametrize("law", LAWS)
def test_flying_grains_move_as_in_plain_numpy(law: str, method: str):
    scene = flying(law)
    _, force, name, *_ = LAWS[law]
    assert name_of(ChainBatch([scene], force).arrays.form[0]) == name
    schedule = Steps(STEPS_EACH, 1, scene.duration / 4 / STEPS_EACH, False)
    fields, stepper = answer(scene, method, schedule, force)
    assert stepper.steps == 4 * STEPS_EACH
    assert distance(fields, plainly(scene, method, STEPS_EACH)) < 1e-13


@pytest.mark.parametrize("method", ["verlet", "rkn4", "rkn6", "dop853", "gear4"])
@pytest.mark.parametrize("name", ACTS)
def test_forced_grains_move_as_in_plain_numpy(name: str, method: str):
    """A burst that ends within a step divides the step into two, except for order 2."""
    scene = acted(name)
    schedule = Steps(STEPS_EACH, 1, scene.duration / 4 / STEPS_EACH, False)
    fields, _ = answer(scene, method, schedule)
    assert distance(fields, plainly(scene, method, STEPS_EACH)) < 2e-13


def test_gear_restarts_where_a_force_ends_in_the_middle_of_a_step():
    """Both parts of the step are equal then; an end elsewhere in the step gives the same error."""
    steps = 96
    step = 2.0 ** np.floor(np.log2(0.12 / ACTED.band_edge))  # Powers of two have exact halves.
    errors = []
    for end in (0.5, 0.50001):
        duration = (steps // 2 + end) * step
        force = Force(shape="half-sine", amplitude=HELD, duration=duration, grain=1)
        scene = scene_of(ACTED, force, steps * step, 2)
        schedule = Steps(steps, 1, step, False)
        (found, _), (true, _) = (answer(scene, method, schedule) for method in ("gear4", "dop853"))
        errors.append(np.abs(found - true).max((1, 2)) / np.abs(true).max((1, 2)))
    assert errors[0] == pytest.approx(errors[1], rel=0.01)


@pytest.mark.parametrize(
    ("method", "acts"),
    [
        ("verlet", None),
        ("rkn6", "burst on grain 1"),
        ("dop853", "burst of the wall"),
        ("gear4", "burst on grain 1"),
    ],
)
def test_grains_on_a_ground_move_as_in_plain_numpy(method: str, acts: str | None):
    """Every grain has a spring of its own, which stiffens in time, also within a step."""
    scene = acted(acts) if acts else flying("springs")
    rate = 6 / scene.duration
    springs = np.linspace(0.5, 0.1, GRAINS) * scene.chain.contacts.stiffness.max()
    law = Law("k*u*(1 + 0.9*tanh(w*t - 3))", k=springs.tolist(), w=rate)

    def ground(x: Any, t: Any) -> Any:
        return springs * x * (1 + WIDE(0.9) * np.tanh(rate * t - 3))

    on_ground = scene.replace(chain=scene.chain.replace(ground=law))
    schedule = Steps(STEPS_EACH, 1, scene.duration / 4 / STEPS_EACH, False)
    fields, _ = answer(on_ground, method, schedule)
    true = plainly(scene, method, STEPS_EACH, ground)
    assert distance(fields, true) < 2e-13
    assert distance(plainly(scene, method, STEPS_EACH), true) > 0.1


@pytest.mark.parametrize(
    ("method", "law"),
    [
        ("verlet", "corrected"),
        ("dop853", "vacuum"),
        ("verlet", "touching wall"),
        ("dop853", "loose grains"),
    ],
)
def test_a_formula_moves_grains_like_the_power_that_it_states(method: str, law: str):
    """The formula has an exponent of its own in each contact, which is 3/2 everywhere."""
    scene = flying(law)
    formula = Law("k*max(o, 0)**p", p=[1.5] * (GRAINS - 1))
    chain = scene.chain.replace(law=formula, exponent=None)
    schedule = Steps(STEPS_EACH, 1, scene.duration / 4 / STEPS_EACH, False)
    fields, _ = answer(scene.replace(chain=chain), method, schedule)
    assert distance(fields, plainly(scene, method, STEPS_EACH)) < 1e-13


@pytest.mark.parametrize("method", ["rkn4", "kahan-li6", "kahan-li8"])
def test_other_splittings_move_grains_as_in_plain_numpy(method: str):
    scene = flying("touching wall, 2")
    fields, _ = answer(scene, method, Steps(6, 1, scene.duration / 24, False), "plain")
    assert distance(fields, plainly(scene, method, 6)) < 1e-13


@pytest.mark.parametrize("method", ["verlet", "rkn6", "dop853", "gear4"])
def test_a_run_lands_on_every_third_sample_and_on_the_last(method: str):
    """The last interval has as many steps as needed for the same step length."""
    scene = flying("corrected").replace(samples=9)
    schedule = Steps(10, 3, 3 * scene.duration / 80, False)
    fields, stepper = answer(scene, method, schedule, "exact")
    interval = WIDE(scene.duration) / 8
    lengths = [3 * interval / 10] * 20 + [2 * interval / 7] * 7
    motion = Motion(plain.column_of(scene))
    run = {"dop853": plain.by_dormand_prince, "gear4": plain.by_gear}.get(method)
    states = (
        run(motion, lengths) if run else plain.by_splitting(motion, SPLITTINGS[method], lengths)
    )
    assert stepper.steps == 27 == schedule.total(8)
    assert distance(fields[:, [0, 3, 6, 8]], states[[0, 10, 20, 27]].swapaxes(0, 1)) < 1e-13
    assert not fields[:, [1, 2, 4, 5, 7]].any()


FOLLOWED = [
    ("verlet", False, 40),
    ("rkn6", False, 16),
    ("rkn6", True, 16),
    ("dop853", False, 12),
    ("gear4", False, 40),
]


@pytest.mark.parametrize(("method", "adaptive", "steps"), FOLLOWED)
def test_a_window_follows_a_wave_in_a_long_chain(method: str, adaptive: bool, steps: int):
    """The motion agrees with plain NumPy, and grains outside the window are exactly at rest."""
    chain = column(240, gravity=0.0, top_load=1e-2)
    u, v = np.zeros((2, 240))
    scale = 5e-3 * chain.equilibrium_overlap[0] * chain.band_edge
    v[119:123] = scale * np.array([1, -0.7, 0.4, 1])
    profile = Profile(displacement=u, velocity=v)
    scene = scene_of(chain, profile, 8 / chain.band_edge, 3)
    fields, stepper = answer(scene, method, Steps(steps, 1, scene.duration / 2 / steps, adaptive))
    assert stepper.steps == 2 * steps
    assert distance(fields, plainly(scene, method, steps)) < 1e-13
    first, last = (stepper.watched[name][0] - PAD for name in ("first", "last"))
    assert 0 < first < 110
    assert 130 < last < 240
    assert not fields[:, :, :first].any()
    assert not fields[:, :, last:].any()
    assert fields[:, -1, 115:127].all()


@pytest.mark.parametrize(
    ("method", "acts"), [("verlet", "fly about"), ("rkn4", "force"), ("rkn4", "wall")]
)
def test_a_chain_of_several_tiles_moves_as_in_plain_numpy(method: str, acts: str):
    """Grains fly everywhere, and a force or a wall acts on one part of the chain."""
    grains = 3 * TILE + 5
    chain = column(grains, gravity=0.0, top_load=1e-2, top="wall", exponent=2.0)
    edge = chain.band_edge
    overlap = chain.equilibrium_overlap[0]
    start = stirred(chain, overlap * edge)
    frequency = 0.1 * edge
    duration = 3 / edge
    excitation = {
        "fly about": lambda: start,
        "force": lambda: Force(amplitude=0.1, frequency=frequency, grain=2 * TILE - 3),
        "wall": lambda: Drive(amplitude=10 * overlap, frequency=frequency, grain=0, start=start),
    }[acts]()
    scene = scene_of(chain, excitation, duration, 2)
    steps = 6
    if method == "rkn4":
        steps = 2
    fields, stepper = answer(scene, method, Steps(steps, 1, duration / steps, False), "plain")
    true = plainly(scene, method, steps)
    assert distance(fields, true) < 1e-13
    assert stepper.steps == steps
    if acts == "fly about":
        closer = chain.contacts.closer(true[0, -1].astype(float))
        assert (closer < -overlap).sum() > 100
