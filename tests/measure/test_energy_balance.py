"""Dissipated energy and work of a forcing, compared with an independent integration of both."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, struck
from helpers.taylor_series import reference
from helpers.thinned import thinned
from helpers.trial_scenes import acted_trial_scene, damped, trial_scene
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from lmpchain import (
    Chain,
    Damping,
    Drive,
    Force,
    Impulse,
    LmpchainError,
    Scene,
    Trajectory,
    simulate,
)
from lmpchain.engines import Modes
from lmpchain.measure import energy

Array = NDArray[np.float64]
WALLS = {"grains": 6, "diameter": 1e-3, "top": "wall", "bottom": "wall", "top_load": 0.1}
DAMPING = Damping(viscoelastic=3e-8, drag=1e3)
POINTS = {"times": [0, 3.3e-6, 1e-5]}
STEEL = {"grains": 10, "material": "steel", "diameter": 1e-2, "exponent": 1.0, "top_load": 1.0}
CASES = {
    # The strike opens contacts; later cases vary damping and forcing.
    "strike": (Chain(**WALLS, damping=DAMPING), Impulse(velocity=3e-2)),
    "contacts alone": (Chain(**WALLS, damping={"viscoelastic": 3e-8}), Impulse(velocity=1e-2)),
    "drag alone": (Chain(**WALLS, damping={"drag": 1e4}), Impulse(velocity=1e-2)),
    "springs": (Chain(**STEEL, damping={"viscoelastic": 4e-7}), Impulse(velocity=1e-3)),
    "force": (Chain(**WALLS, damping=DAMPING), Force(grain=2, amplitude=1e-2, frequency=1e5)),
    "burst": (
        Chain(**WALLS, damping={"viscoelastic": 3e-8}),
        Force(grain=3, amplitude=0.1, frequency=1e5, cycles=2),
    ),
    "points": (
        Chain(**WALLS, damping=DAMPING),
        Force(grain=1, **POINTS, force=[0, 0.1, 0.05], interpolation="linear"),
    ),
    "drive": (Chain(**WALLS, damping=DAMPING), Drive(amplitude=1e-8, frequency=1e5)),
    "tone": (Chain(**WALLS, damping=DAMPING), Drive(amplitude=1e-8, frequency=1e5, cycles=3)),
    # The speed of the driven grain jumps between samples.
    "jumps": (
        Chain(**WALLS, damping=DAMPING),
        Drive(**POINTS, displacement=[0, 1e-8, 0], interpolation="linear"),
    ),
    "wall": (
        Chain(**WALLS, damping=DAMPING),
        Drive(grain=0, **POINTS, displacement=[0, 1e-8, 0], interpolation="linear"),
    ),
    "lossless drive": (Chain(**WALLS), Drive(amplitude=1e-9, frequency=1e5)),
    "lossless force": (Chain(**WALLS), Force(grain=2, amplitude=1e-3, frequency=1e5)),
}


def case(name: str, samples: int) -> Scene:
    return scene_of(*CASES[name], 3e-4 if name == "springs" else 4e-5, samples)


def integrate(scene: Scene) -> tuple[Array, Array]:
    """Return dissipated energy and work of a force or drive, (T,) J, by SciPy's DOP853."""
    chain = scene.chain
    size = chain.grains
    contacts = chain.contacts
    wave = scene.excitation.waveform
    wall = scene.excitation.wall
    driven = scene.excitation.driven
    grain = scene.excitation.acts_on
    straight = getattr(scene.excitation, "interpolation", "") == "linear"
    free = np.arange(size) < chain.movable
    free[:driven] = False

    def rates(t: float, y: Array, inside: float) -> Array:
        u, v = y[: 2 * size].reshape(2, size).copy()
        top = np.zeros(2)
        if wave and (driven or wall):
            # A straight line has one slope, which is evaluated in its middle.
            moved = float(wave.at(t)), float(wave.at(inside if straight else t, 1))
            if driven:
                u[0], v[0] = moved
            else:
                top[:] = moved
        x = np.zeros((2, size + 2))
        x[:, 0] = top
        x[:, 1:-1] = u, v
        closer, closing = x[:, :-1] - x[:, 1:]
        overlap = contacts.overlap + closer
        pressed = np.maximum(overlap, 0.0)
        viscous = contacts.constant * chain.exponent * pressed ** (chain.exponent - 1)
        viscous = np.where(overlap > 0, chain.contact_viscosity * viscous * closing, 0.0)
        force = contacts.constant * pressed**chain.exponent - contacts.force + viscous
        drag = np.where(free, chain.masses * chain.drag, 0.0)
        inner = force[:-1] - force[1:] - drag * v
        power = 0.0
        if wave and wall:
            power = force[0] * top[1]
        elif wave and driven:
            power = (force[1] - force[0]) * v[0]
        elif wave:
            inner[grain - 1] += float(wave.at(t))
            power = float(wave.at(t)) * v[grain - 1]
        a = np.where(free, inner / chain.masses, 0.0)
        lost = float(viscous @ closing + drag @ v**2)
        return np.concatenate((np.where(free, v, 0.0), a, [lost, power]))

    u, v = scene.initial()
    y = np.concatenate((u, v, [0.0, 0.0]))
    scales = chain.length_scale, chain.length_scale / chain.time_scale
    mass = float(chain.masses[0]) * scales[1] ** 2
    atol = 1e-15 * np.repeat([*scales, mass], [size, size, 2])
    results = [y[-2:]]
    kinks = [] if wave is None else [t for t in wave.kinks if 0 < t < scene.duration]
    edges = np.union1d(scene.time, kinks)
    for begin, end in pairwise(edges):
        part = solve_ivp(
            rates, (begin, end), y, "DOP853", args=((begin + end) / 2,), rtol=1e-12, atol=atol
        )
        y = part.y[:, -1]
        if end in scene.time:
            results.append(y[-2:])
    lost, work = np.array(results).T
    if wave and driven:
        work = work + chain.masses[0] / 2 * (wave.at(scene.time, 1) ** 2 - wave.at(0.0, 1) ** 2)
    return lost, work


LINEAR = STEEL | {"grains": 6, "top": "wall", "bottom": "wall", "top_load": 50.0, "gravity": 0.0}
FREQUENCY = 4e4
LINEAR_DAMPING = {
    "lossless": {},
    "damped": {"viscoelastic": 4e-7, "drag": 2e3},
    "overdamped": {"viscoelastic": 3e-6, "drag": 1e3},
}
LINEAR_ACTS = {
    "strike": Impulse(velocity=1e-3),
    "force": Force(grain=2, amplitude=0.1, frequency=FREQUENCY),
    "burst": Force(grain=3, amplitude=0.1, frequency=FREQUENCY, cycles=2),
    "hammer": Force(grain=1, shape="half-sine", amplitude=0.1, duration=7e-5),
    "drive": Drive(amplitude=1e-8, frequency=FREQUENCY),
    "tone": Drive(amplitude=1e-8, frequency=FREQUENCY, cycles=3),
    "wall": Drive(grain=0, amplitude=1e-8, frequency=FREQUENCY),
}


@cache
def exact_linear(damping: str, act: str) -> tuple[Scene, Array, Array]:
    chain = Chain(**LINEAR, damping=LINEAR_DAMPING[damping])
    scene = scene_of(chain, LINEAR_ACTS[act], 1e-4, 41)
    return scene, *integrate(scene)


@cache
def exact(name: str) -> tuple[Array, Array]:
    return integrate(case(name, 41))


def largest(values: Array) -> float:
    return float(np.abs(values).max())


@pytest.mark.parametrize("samples", [3, 41])
@pytest.mark.parametrize("name", thinned(CASES, 2))
def test_losses_and_work_close_the_balance_by_any_number_of_samples(name: str, samples: int):
    t = simulate(case(name, samples), "native", 1e-10)
    balance = energy.ledger(t)
    put_in = largest(balance.total)
    assert largest(balance.drift) < 1e-9 * put_in
    assert largest(balance.momentum_drift) < 1e-9 * largest(balance.momentum)
    # With damping, neither energy follows from the balance.
    assert set(balance.balanced) & {"drive", "dissipated"} == (
        {"drive"} if name.startswith("lossless") else set()
    )
    shown = slice(None, None, 40 // (samples - 1))
    for value, error, true in zip(
        (balance.dissipated, balance.drive),
        (balance.dissipated_error, balance.drive_error),
        exact(name),
        strict=True,
    ):
        assert largest(value - true[shown]) <= error + 1e-11 * put_in
        assert error < 1e-8 * put_in
    lost = energy.losses(t)
    assert largest(lost.total - exact(name)[0][shown]) <= lost.error + 1e-11 * put_in
    known = largest(lost.total - balance.dissipated) + balance.dissipated_error
    assert lost.error >= known or not t.scene.chain.damped


LINEAR_CASES = [
    *(("modes", "damped", act) for act in LINEAR_ACTS),
    *(("modes", "overdamped", act) for act in ("strike", "force", "wall")),
    *(("modes", "lossless", act) for act in ("strike", "burst", "tone", "wall")),
    ("chebyshev", "lossless", "drive"),
    ("chebyshev", "lossless", "wall"),
]


@pytest.mark.parametrize("samples", [3, 41])
@pytest.mark.parametrize(("engine", "damping", "act"), thinned(LINEAR_CASES, 4))
def test_linear_engines_close_the_balance_by_any_number_of_samples(engine, damping, act, samples):
    """Springs that stay closed are linear: linear engines solve Eq. (1) itself."""
    scene, *true = exact_linear(damping, act)
    t = simulate(scene.replace(samples=samples), engine, 1e-6)
    balance = energy.ledger(t)
    # Without damping the work follows from the balance, and the reference below checks it.
    assert set(balance.balanced) & {"drive", "dissipated"} == (
        {"drive"} if damping == "lossless" and act != "strike" else set()
    )
    # The energy may be near 0 at three samples.
    put_in = max(map(largest, (balance.total, *true)))
    assert largest(balance.drift) < 1e-9 * put_in
    shown = slice(None, None, 40 // (samples - 1))
    for name, exact_energy in zip(("dissipated", "drive"), true, strict=True):
        error = getattr(balance, f"{name}_error")
        off = largest(getattr(balance, name) - exact_energy[shown])
        assert off <= error + 1e-11 * put_in, name
        assert error < 1e-7 * put_in, name


@pytest.mark.parametrize("samples", [3, 41])
@pytest.mark.parametrize("act", [Impulse(velocity=1e-4), Drive(amplitude=1e-10, frequency=1e5)])
def test_errors_of_linear_energies_include_the_model_error(act, samples: int):
    chain = Chain(**WALLS, damping=DAMPING)
    scene = scene_of(chain, act, 6e-5, samples)
    found = energy.ledger(simulate(scene, "modes", 0.5))
    true = energy.ledger(simulate(scene, "native", 1e-11))
    for name in ("dissipated", "drive"):
        off = largest(getattr(found, name) - getattr(true, name))
        assert off <= getattr(found, f"{name}_error")
    assert 1e-8 * largest(true.total) < found.dissipated_error < 0.2 * largest(true.total)


@pytest.mark.parametrize(
    ("engine", "act"),
    [
        ("modes", Impulse(velocity=1e-9)),
        ("modes", Drive(amplitude=1e-15, frequency=1e5)),
        ("chebyshev", Drive(amplitude=1e-15, frequency=1e5)),
        ("lammps", Impulse(velocity=1e-3)),
        ("lammps", Drive(amplitude=1e-9, frequency=1e5)),
    ],
)
@pytest.mark.parametrize("samples", [3, 41])
def test_other_engines_agree_with_the_native_one(engine: str, act, samples: int):
    """The energies of linear theory (for weak waves) and LAMMPS are within their errors."""
    damping = DAMPING if engine != "chebyshev" else {}
    chain = Chain(**WALLS, damping=damping)
    scene = scene_of(chain, act, 6e-5, samples)
    tolerance = 1e-3 if engine == "lammps" else 1e-6
    found = energy.ledger(simulate(scene, engine, tolerance))
    true = energy.ledger(simulate(scene, "native", 1e-11))
    put_in = largest(true.total)
    for name in ("dissipated", "drive"):
        error = getattr(found, f"{name}_error")
        assert largest(getattr(found, name) - getattr(true, name)) <= error + 1e-10 * put_in
        assert error < 0.02 * put_in, name


def test_a_foreign_trajectory_uses_only_its_samples():
    t = simulate(case("strike", 401), "native", 1e-10)
    foreign = of_error(t)
    found = energy.ledger(foreign)
    assert found.balanced == ()
    assert 0 < largest(found.drift) < found.dissipated_error < 1e-3 * found.total[0]
    # The error of an inaccurate solution is included.
    rough = of_error(t, 1e-3)
    assert energy.losses(rough).error > 1e-4 * found.total[0] > energy.losses(t).error


@pytest.mark.parametrize(
    ("place", "bottom", "driven"),
    [
        ({"grain": 0}, "wall", None),
        ({"grain": 1}, "wall", 1),
        ({"end": "bottom"}, "wall", None),
        ({"end": "bottom"}, "fixed", 6),
    ],
)
def test_samples_alone_show_the_work_and_losses_of_a_driver(
    place: dict[str, Any], bottom: str, driven: int | None
):
    """Integrals over dense samples agree with those that were accumulated, within small errors."""
    shaker = Drive(**place, amplitude=1e-8, frequency=1e5)
    chain = Chain(**WALLS | {"bottom": bottom}, damping=DAMPING)
    t = run(chain, shaker, 4e-5, 401, 1e-10)
    foreign = of_error(t)
    known, found = energy.ledger(t), energy.ledger(foreign)
    for name in ("drive", "dissipated"):
        off = largest(getattr(found, name) - getattr(known, name))
        assert off <= getattr(found, f"{name}_error") < 1e-3 * largest(getattr(known, name))
    assert largest(found.momentum_drift) <= found.impulse_error < 1e-3 * largest(found.impulse)
    lost = energy.losses(foreign)
    assert largest(lost.total - known.dissipated) <= lost.error < 1e-3 * lost.total[-1]
    # A driven grain has no drag.
    drag = np.trapezoid(1e3 * chain.masses * t.velocity**2, t.time, axis=0)
    if driven:
        drag[driven - 1] = 0
    assert lost.of_grain[-1] == pytest.approx(drag, rel=1e-2)


def test_files_without_energies_are_read(tmp_path: Path, monkeypatch):
    """A quadrature that takes too long is left out: the balance yields the losses of a strike."""
    monkeypatch.setattr(Modes, "most_summed", lambda _self, _scene: 0)
    scene = struck(Chain(**WALLS, damping=DAMPING), 1e-9, 6e-3, 5)
    t = simulate(scene, "modes", folder=tmp_path / "run")
    assert not t.gathered
    t.save(tmp_path / "run.nc")
    assert Trajectory.load(tmp_path / "run.nc") == t
    assert energy.ledger(t).balanced == ("dissipated", "impulse")


def test_grains_beyond_the_wave_do_not_change_energies():
    """The light cone of a long chain has the energies of the whole, and of a shorter chain."""
    found = []
    for grains in (300, 3000):
        chain = column(grains, damping={"viscoelastic": 1e-9})
        scene = struck(chain, 1e-3, 2e-5, 5)
        found.append(simulate(scene, "native", 1e-10).gathered["dissipated"])
    assert found[1] == pytest.approx(found[0], rel=1e-12)
    assert found[0][-1] > 0


@pytest.mark.slow
@pytest.mark.parametrize("acts", [False, True])
@pytest.mark.parametrize("seed", range(30))
def test_stated_errors_hold_in_random_scenes(seed: int, acts: bool):
    """Dissipation minus work equals the energy loss of a Taylor-series solution."""
    rng = np.random.default_rng([77, seed])
    draw = acted_trial_scene if acts else trial_scene
    scene = draw(rng, work=1e3)
    while scene.chain.grains > 100:
        scene = draw(rng, work=1e3)
    scene = damped(rng, scene).replace(grains="all")
    true, off = reference(scene, 1e-18)
    if off > 1e-12:
        pytest.skip("the reference is not sure enough")
    wall = scene.excitation.wall
    top = wall.at(scene.time, 0) if wall else None
    total = scene.chain.excess_energy(true.displacement, true.velocity, top)
    try:
        t = simulate(scene, "native", 10.0 ** -rng.uniform(3, 11))
    except LmpchainError:
        pytest.skip("rounding alone may exceed this tolerance")
    found = energy.ledger(t)
    scale = max(map(largest, (total, found.dissipated, found.drive)))
    off = largest(found.dissipated - found.drive - (total[0] - total))
    assert off <= found.dissipated_error + found.drive_error + 1e-15 * scale


@pytest.mark.parametrize("samples", [3, 5, 9, 41, 401])
def test_samples_alone_state_an_infinite_error_where_they_do_not_resolve_the_motion(
    samples: int, monkeypatch
):
    monkeypatch.setattr(Modes, "most_summed", lambda self, scene: 0)
    scene = exact_linear("damped", "hammer")[0].replace(duration=6e-4, samples=samples)
    summed = energy.ledger(simulate(scene, "native", 1e-10))
    linear = energy.ledger(simulate(scene, "modes", 1e-10))
    for name in ("dissipated", "drive"):
        off = np.abs(getattr(linear, name) - getattr(summed, name)).max()
        assert off <= getattr(linear, f"{name}_error") + getattr(summed, f"{name}_error")
    assert np.isfinite(linear.drive_error) == (samples == 401)


@pytest.mark.parametrize("samples", [3, 41])
@pytest.mark.parametrize(
    "excitation",
    [
        Drive(amplitude=2e-8, frequency=4e4),
        Drive(grain=0, amplitude=2e-8, frequency=4e4),
        Force(grain=3, shape="half-sine", amplitude=0.02, duration=2e-5),
    ],
)
def test_work_without_losses_equals_accumulated_work_with_little_loss(
    excitation: Drive | Force, samples: int
):
    """Without damping, work follows from the balance; with a drag of 1e-7 /s it is summed."""
    chain = Chain(**WALLS)
    scene = scene_of(chain, excitation, 6e-5, samples)
    dragged = scene.replace(chain=chain.replace(damping={"drag": 1e-7}))
    exact = energy.ledger(simulate(scene, "native", 1e-10))
    summed = energy.ledger(simulate(dragged, "native", 1e-10))
    assert "drive" in exact.balanced
    assert "drive" not in summed.balanced
    assert np.abs(exact.drive - summed.drive).max() < 1e-10 * np.abs(summed.total).max()
