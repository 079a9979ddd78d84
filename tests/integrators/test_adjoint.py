"""Adjoint and tangent of a run against differences of plain NumPy in 80-bit numbers."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numba
import numpy as np
import pytest
from helpers import plain_methods as plain
from helpers.flying_grains import flying as flying_grains
from helpers.flying_grains import forcings, unlike
from helpers.plain_methods import WIDE, Column, Motion
from helpers.thinned import thinned

from lmpchain import Chain, Drive, Force, Impulse, Profile, Scene
from lmpchain.integrators import adjoint, adjoint_dop853
from lmpchain.integrators.adjoint import CHECKPOINTS, DifferentiableRun, Inputs
from lmpchain.integrators.differentiation import DIFFERENTIABLE, differentiable
from lmpchain.integrators.kernels.adjoint_rows import Way, hertz_power, power, touch
from lmpchain.integrators.methods import SPLITTINGS

GRAINS = 6
LOOKS = 3
BETWEEN = {"top": "wall", "bottom": "wall", "top_material": "brass"}
DIFFERENCE = WIDE(1e-7)  # Relative change for differences.


def pressed(**options: Any) -> Chain:
    return unlike(GRAINS, **options)


def flying(strains: float, **options: Any) -> Scene:
    """Return a scene of moving grains whose contacts differ from rest by this many overlaps."""
    return flying_grains(pressed(**options), 5, (strains / 2, strains), 8, LOOKS + 1)


VACUUM: dict[str, Any] = {"gravity": 0.0, "top_load": 0.0}
LAWS = {
    "undone, plain": (flying(3.0), Way.UNDONE_PLAIN),
    "undone, plain, walls": (flying(3.0, **BETWEEN), Way.UNDONE_PLAIN),
    "undone, exact": (flying(0.05, bottom="wall"), Way.UNDONE_EXACT),
    "undone by a series": (flying(1e-4, exponent=1.8, **BETWEEN), Way.UNDONE_SERIES),
    "undone by a short series": (flying(1e-6), Way.UNDONE_SERIES),
    "vacuum": (flying(1.0, **VACUUM, **BETWEEN), Way.VACUUM),
    "free vacuum": (flying(1.0, **VACUUM, bottom="free"), Way.VACUUM),
    "touching wall, strong": (flying(3.0, top_load=0.0, **BETWEEN), Way.PLAIN),
    "touching wall": (flying(0.05, top_load=0.0, **BETWEEN), Way.HERTZ),
    "touching wall, 2": (flying(2.0, top_load=0.0, exponent=2.0, **BETWEEN), Way.OTHER),
    "loose grains, strong": (flying(3.0, gravity=0.0, load_grain=3, bottom="wall"), Way.PLAIN),
    "loose grains": (flying(0.05, gravity=0.0, load_grain=3), Way.OTHER),
    "springs": (flying(2.0, exponent=1.0, **BETWEEN), Way.OTHER),
    "5/4": (flying(2.0, exponent=1.25), Way.OTHER),
    "2": (flying(2.0, exponent=2.0, bottom="wall"), Way.OTHER),
    "3": (flying(2.0, exponent=3.0, **BETWEEN), Way.OTHER),
    "vacuum, 2.3": (flying(1.0, **VACUUM, exponent=2.3, bottom="free"), Way.OTHER),
}

ACTED = pressed(**BETWEEN)
ACTS = forcings(ACTED, 8, interpolation="linear")
ACTING = [name for name in ACTS if name not in ("burst of grain 1", "sine of the wall")]


def acted(name: str, **options: Any) -> Scene:
    chain = pressed(**BETWEEN, **options)
    duration = 8 / ACTED.band_edge
    return Scene(chain=chain, excitation=ACTS[name], duration=duration, samples=LOOKS + 1)


def sizes(scene: Scene, states: np.ndarray) -> Inputs:
    """Return the allowed change of each input; 0 for inputs that cannot change."""
    chain = scene.chain
    contacts = scene.chain.contacts
    u, v = (np.abs(states[:, order]).max() for order in (0, 1))
    moving = np.arange(chain.grains) < chain.movable
    moving[: scene.excitation.driven] = False
    drive = plain.column_of(scene).drive.astype(float)
    return Inputs(
        chain.masses,
        contacts.constant,
        np.where(contacts.pressed, contacts.force, 0.0),
        u * moving,
        v * moving,
        np.full(drive.size, np.abs(drive).max(initial=0.0)) if drive.size != 2 else drive,
        np.zeros(chain.grains + 1),
        np.zeros(chain.grains),
    )


def differences(
    scene: Scene, method: str, steps: list[Any], looks: list[int]
) -> tuple[np.ndarray, Inputs, Inputs]:
    """Return states (looks+1, 2, N), directions for each input that may change, and slopes.

    Directions are rows of `Inputs`, and slopes (D, looks+1, 2, N), by the relative size of a
    change.
    """
    base = plain.column_of(scene)
    true = plain.by_splitting(Motion(base), SPLITTINGS[method], steps)[looks]
    size = sizes(scene, true)
    lengths = [field.size for field in size]
    total = sum(lengths)
    begins = np.cumsum([0, *lengths])
    directions = []
    for field, begin in zip(size, begins[:-1], strict=True):
        rows = np.zeros((total, field.size))
        rows[begin + np.arange(field.size), np.arange(field.size)] = field
        directions.append(rows)
    if (
        scene.excitation.does_work
        and scene.excitation.frequency is None
        and scene.excitation.times is None
    ):
        directions[5][:, 1] = 0  # A forcing of given duration has no frequency.
    states = []
    for sign in (1, -1):
        changed = [
            value + sign * DIFFERENCE * rows
            for value, rows in zip(base[:6], directions[:6], strict=True)
        ]
        states.append(
            plain.by_splitting(Motion(Column(*changed, scene)), SPLITTINGS[method], steps)[looks]
        )
    slopes = (states[0] - states[1]) / (2 * DIFFERENCE)  # Shape (looks+1, 2, D, N).
    return true, Inputs(*directions), np.moveaxis(slopes, 2, 0)


def check(
    scene: Scene, method: str, law: int, grains: list[int], accuracy: float = 1e-8, each: int = 5
) -> None:
    """Compare a run, its tangent and its adjoint with plain NumPy."""
    step = scene.duration / LOOKS / each
    run = DifferentiableRun(
        scene, SPLITTINGS[method], step * (1 + 0.5 / each), LOOKS, np.array(grains)
    )
    assert run.law.way == law
    assert run.steps == LOOKS * each
    assert run.step == pytest.approx(step, rel=1e-14)
    lengths = [WIDE(scene.duration) / (LOOKS * each)] * (LOOKS * each)
    check_run(scene, method, run, lengths, each * np.arange(LOOKS + 1), accuracy)


def check_run(
    scene: Scene,
    method: str,
    run: DifferentiableRun,
    lengths: list[Any],
    looks: Any,
    accuracy: float,
):
    columns = run.grains - 1
    true, directions, slopes = differences(scene, method, lengths, looks)
    scale = np.abs(true).max((0, 2))
    for order, field in enumerate((run.displacement, run.velocity)):
        assert np.abs(field - true[:, order, columns]).max() < 1e-12 * scale[order]
    forth = np.array(run.push(directions))  # Shape (2, D, looks+1, G).
    slopes = slopes[..., columns]
    largest = np.abs(slopes).max((1, 3)) + 1e-300
    for order in (0, 1):
        error = np.abs(forth[order] - slopes[:, :, order]).max((1, 2))
        # Small slopes have the absolute error of the large ones.
        assert (
            error <= accuracy * np.maximum(largest[:, order], 1e-3 * largest[:, order].max())
        ).all()
    weights = (
        np.random.default_rng(1).normal(size=(2, *run.displacement.shape))
        / scale.astype(float)[:, None, None]
    )
    back = run.pull(*weights)
    along = sum(rows @ field for rows, field in zip(directions, back, strict=True))
    expected = np.einsum("otg,dtog->d", weights, slopes)
    terms = np.einsum("otg,dtog->d", np.abs(weights), np.abs(slopes))
    assert (np.abs(along - expected) <= accuracy * np.maximum(terms, 1e-3 * terms.max())).all()


# The quick suite alternates between both methods.
CASES = [
    (law, method)
    for number, law in enumerate(LAWS)
    for method in (("verlet", "rkn4") if number % 2 else ("rkn4", "verlet"))
]


@pytest.mark.parametrize(("law", "method"), thinned(CASES, 2))
def test_derivatives_of_flying_grains_agree_with_differences(law: str, method: str):
    scene, kind = LAWS[law]
    check(scene, method, kind, [1, 2, 3, 6] if method == "verlet" else [5, 2])


# The quick suite alternates between steps that are undone and steps that are recomputed.
FORCED = [
    (name, exponent)
    for number, name in enumerate(ACTING)
    for exponent in ((1.5, 1.7) if number % 2 else (1.7, 1.5))
]


@pytest.mark.parametrize(("name", "exponent"), thinned(FORCED, 2))
def test_derivatives_of_forced_grains_agree_with_differences(name: str, exponent: float):
    scene = acted(name, exponent=exponent)
    law = (
        Way.OTHER
        if exponent != 1.5
        else DifferentiableRun(scene, SPLITTINGS["verlet"], 1, 1, [1]).law.way
    )
    check(scene, "rkn4", law, [1, 2, 4, 6])


@pytest.mark.parametrize(
    "law", ["undone, plain, walls", "undone by a series", "touching wall", "3"]
)
def test_derivatives_of_many_steps_agree_with_differences(
    law: str, monkeypatch: pytest.MonkeyPatch
):
    """Between checkpoints, steps are undone or recomputed."""
    short = CHECKPOINTS._replace(kept_bytes=1, undone_rows=64)
    monkeypatch.setattr(adjoint, "CHECKPOINTS", short)
    scene, kind = LAWS[law]
    check(scene, "verlet", kind, [1, 2, 5, 6], accuracy=1e-7, each=40)


@pytest.mark.parametrize(
    "name", ["sine of grain 1", "samples of the wall", "half-sine on the last grain"]
)
def test_derivatives_of_forced_grains_in_many_calls_agree_with_differences(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    short = CHECKPOINTS._replace(kept_bytes=1, rows_of_call=1)
    monkeypatch.setattr(adjoint, "CHECKPOINTS", short)
    check(acted(name, exponent=1.7), "verlet", Way.OTHER, [1, 2, 5, 6], each=30)


def test_derivatives_with_unequal_steps_agree_with_differences(rng):
    scene, _ = LAWS["touching wall, 2"]
    parts = [rng.uniform(0.5, 1.5, count) for count in (4, 7, 3)]
    steps = [part / part.sum() * scene.duration / LOOKS for part in parts]
    run = DifferentiableRun(scene, SPLITTINGS["rkn4"], steps, LOOKS, np.array([1, 4, 6]))
    assert run.steps == 14
    assert run.step == pytest.approx(max(part.max() for part in steps), rel=1e-15)
    assert run.time == pytest.approx(scene.duration * np.arange(LOOKS + 1) / LOOKS, rel=1e-15)
    lengths = [WIDE(h) for h in np.concatenate(steps)]
    check_run(scene, "rkn4", run, lengths, np.array([0, 4, 11, 14]), 1e-8)


EVERY = slice(899)
LONG = {
    "undone, plain": (1e-2, slice(1), {}, Way.UNDONE_PLAIN),
    "undone, exact, struck inside": (3e-3, slice(380, 400), {"top_load": 0.1}, Way.UNDONE_EXACT),
    "undone, exact": (2e-3, EVERY, {"top_load": 1.0}, Way.UNDONE_EXACT),
    "undone by a series": (1e-7, EVERY, {"exponent": 2.5}, Way.UNDONE_SERIES),
    "vacuum": (1e-2, EVERY, {"gravity": 0.0}, Way.VACUUM),
    "vacuum, struck inside": (1e-2, slice(380, 400), {"gravity": 0.0}, Way.VACUUM),
    "touching wall": (1e-2, EVERY, {"top": "wall"}, Way.PLAIN),
    "touching wall, struck inside": (0.3, slice(380, 400), {"top": "wall"}, Way.PLAIN),
    "2.5, struck inside": (1e-2, slice(380, 400), {"exponent": 2.5}, Way.OTHER),
    # Between two rows this grain passes from one tile to the other.
    "undone, plain, pushed": (1e-2, 380, {}, Way.UNDONE_PLAIN),
    "2.5, pushed": (1e-2, 380, {"exponent": 2.5}, Way.OTHER),
    "2.5, driven": (1e-2, 1, {"exponent": 2.5}, Way.OTHER),
}


@pytest.mark.parametrize("law", LONG)
def test_long_chains_have_the_same_derivatives_back_and_forth(rng: np.random.Generator, law: str):
    """Windows grow, or tiles are used, within the light cone or everywhere."""
    speed, struck, options, kind = LONG[law]
    chain = Chain(grains=900, diameter=1e-3, **options)
    excitation: Any
    if isinstance(struck, slice):
        velocity = np.zeros(900)
        velocity[struck] = speed * rng.uniform(-1, 1, velocity[struck].size)
        excitation = Profile(velocity=velocity)
    elif struck == 1:
        overlap = chain.contacts.overlap[1]
        excitation = Drive(amplitude=overlap, frequency=0.05 * chain.band_edge)
    else:
        excitation = Force(amplitude=speed, frequency=0.05 * chain.band_edge, grain=struck)
    scene = Scene(chain=chain, excitation=excitation, duration=1e-4)
    step = 0.5 / scene.highest_frequency
    # Some of the grains are beyond the wave, near the ends of windows.
    grains = np.array([1, 2, 60, *range(290, 600, 10), 800])
    run = DifferentiableRun(scene, SPLITTINGS["rkn4"], step, 4, grains)
    if kind != Way.UNDONE_SERIES:
        assert run.law.way == kind
    weights = rng.normal(size=(2, *run.velocity.shape))
    weights[0] *= scene.highest_frequency
    changes = Inputs(
        chain.masses * rng.normal(size=(1, 900)),
        chain.contacts.constant * rng.normal(size=(1, 901)),
        chain.contacts.force * rng.normal(size=(1, 901)),
        np.zeros((1, 900)),
        np.zeros((1, 900)),
        excitation.numbers * rng.normal(size=(1, 2)) if run.imposed else np.zeros((1, 0)),
        np.zeros((1, 901)),
        np.zeros((1, 900)),
    )
    everywhere = changes._replace(
        velocity=speed * rng.normal(size=(1, 900)), displacement=1e-9 * rng.normal(size=(1, 900))
    )
    for change, whole in ((changes, False), (changes, True), (everywhere, True)):
        back = run.pull(*weights) if whole else run.pull(*weights, everywhere=False)
        u, v = run.push(change)
        terms = np.array([weights[0] * u[0], weights[1] * v[0]])
        along = sum(float(rows[0] @ field) for rows, field in zip(change, back, strict=True))
        assert abs(terms.sum() - along) <= 1e-11 * np.abs(terms).sum()


@pytest.mark.parametrize(
    ("method", "steps", "options"),
    [
        ("verlet", 20_000, {}),  # Steps are undone.
        ("verlet", 20_000, {"top": "wall"}),
        ("dop853", 4_000, {"damping": {"drag": 10.0}}),
    ],
)
def test_memory_of_derivatives_is_limited(
    method: str, steps: int, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
):
    """The states of all steps would take more than 20 MB."""
    chain = Chain(grains=100, diameter=1e-3, **options)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-4)

    def derivatives() -> tuple[int, int, np.ndarray]:
        """Return the memory after the run, the largest one, bytes, and the gradient over masses."""
        tracemalloc.start()
        run = differentiable(
            scene, DIFFERENTIABLE[method], scene.duration / steps, 1, np.array([1])
        )
        of_run = tracemalloc.get_traced_memory()[0]
        masses = run.pull(np.zeros((2, 1)), np.ones((2, 1))).masses
        largest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return of_run, largest, masses

    derivatives()  # The first run loads compiled code.
    usual, largest, masses = derivatives()
    assert largest < 3e6
    # A run with fewer checkpoints retains less.
    for module in (adjoint, adjoint_dop853):
        less = module.CHECKPOINTS._replace(total_bytes=2**15)
        monkeypatch.setattr(module, "CHECKPOINTS", less)
    of_run, _, same = derivatives()
    assert of_run < usual - 2**15
    np.testing.assert_allclose(same, masses, rtol=0, atol=1e-11 * np.abs(masses).max())


@numba.njit
def powers_of(s: np.ndarray, c: float, less: float, out: np.ndarray):
    """Fill out with p by `hertz_power` and by `power`, and with p of a contact that touches."""
    for n in range(s.size):
        out[0, n] = hertz_power(s[n], c)
        out[1, n] = power(s[n], c, less)
        out[2, n], out[3, n] = touch(s[n], 3.0, less)


def test_powers_of_overlaps_are_accurate_at_any_amplitude(rng: np.random.Generator):
    s = 10 ** rng.uniform(-12, 1.5, 300) * rng.choice([1, -1], 300)
    s = np.append(s[s > -1], [-1.0, 0.0])
    out = np.zeros((4, s.size))
    wide = s.astype(WIDE)
    epsilon = np.finfo(float).eps
    with np.errstate(divide="ignore"):
        whole = np.log1p(wide)
    for less in (0.5, 1.3):
        powers_of(s, 1.0, less, out)
        root = wide / (1 + np.sqrt(1 + wide))
        for found, true in ((out[0], root), (out[1], np.expm1(less * whole))):
            assert (np.abs(found - true) <= 4 * epsilon * np.abs(true)).all()
        powers_of(np.abs(s), 0.0, less, out)
        true = np.abs(wide) ** less
        # The exponential multiplies the rounding error of its argument, up to 36.
        assert (np.abs(out[1] - true) <= 36 * epsilon * true).all()
        powers_of(s, 0.0, less, out)
        true = np.maximum(wide, 0) ** less
        both = np.array([true, 3 * wide * true])
        assert (np.abs(out[2:] - both) <= 4 * epsilon * np.abs(both)).all()


def test_few_terms_suffice_for_weak_waves():
    for exponent in (0.05, 0.5, 1.25, 2.5):
        for reach, terms in ((0.0, 4), (1e-4, 4), (1e-3, 6), (5e-3, 6)):
            coefficients = adjoint.economise(exponent, reach)
            s = np.linspace(-1, 1, 42, dtype=WIDE) * max(reach, 1e-15)
            true = np.expm1(exponent * np.log1p(s)) / s
            series = np.polynomial.polynomial.polyval(s, coefficients)
            assert coefficients.size == terms
            assert np.abs(series - true).max() < 3e-16 * exponent
