"""Orbits of damped, driven chains: closed forms, extended precision, SciPy and long runs."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.thinned import thinned
from scipy.integrate import solve_ivp

from lmpchain import Chain, Damping, Drive, Force, InputError, Profile, Scene, orbits, simulate
from lmpchain.errors import RunFailed
from lmpchain.orbits import Family, Orbit
from lmpchain.orbits.flow import Flow

LEVEL = {"diameter": 1e-2, "gravity": 0.0, "top_load": 20.0}
TRIMER = Chain(
    grains=4,
    material=["steel", "ptfe", "steel", "brass"],
    damping={"viscoelastic": [3e-7, 1e-7, 2e-7], "drag": [500.0, 2000.0, 1000.0, 700.0]},
    bottom="wall",
    **LEVEL,
)
# One grain between a driven grain and a wall.
ONE = Chain(grains=2, material="steel", damping={"drag": 2000.0}, bottom="wall", **LEVEL)
OVERLAP = float(ONE.contacts.overlap[1])
OMEGA = float(np.sqrt(ONE.contacts.stiffness[1:3].sum() / ONE.masses[1]))


@cache
def resonance() -> Family:
    """Return the response of one grain from below its softening resonance through two folds."""
    drive = Drive(amplitude=0.05 * OVERLAP, frequency=0.75 * OMEGA / (2 * np.pi))
    return orbits.follow(orbits.find(ONE, drive=drive), "drive.frequency", 1.1 * OMEGA / 6.283)


def rate(orbit: Orbit) -> Callable[[float, np.ndarray], np.ndarray]:
    """Return the right-hand side of damped Eq. (1) for free grains, and its derivatives."""
    chain = orbit.chain
    drive = orbit.drive
    assert drive is not None
    held = int(isinstance(drive, Drive) and drive.grain == 1)
    mass = chain.masses[held:, None]
    constant = chain.contacts.constant[held:, None]
    rest = chain.contacts.force[held:, None]
    delta = chain.exponent
    overlap = np.where(constant > 0, (rest / np.where(constant > 0, constant, 1)) ** (1 / delta), 0)
    viscosity = chain.contact_viscosity[held:, None]
    drag = chain.drag[held:, None]
    omega = 2 * np.pi * drive.frequency
    size = drive.amplitude

    def closer(u: np.ndarray, top: float) -> np.ndarray:
        ends = np.zeros((1, u.shape[1]))
        return -np.diff(np.concatenate((ends + top, u, ends)), axis=0)

    def move(t: float, y: np.ndarray) -> np.ndarray:
        """Return the rates of u and v, both (M,), followed by the rates of C deviations (2M, C)."""
        u, v = y[:, :1].reshape(2, -1, 1)
        push = np.zeros_like(u)
        top = (0.0, 0.0)
        if isinstance(drive, Force):
            push[drive.grain - 1] = size * np.sin(omega * t)
        else:
            top = (size * np.sin(omega * t), omega * size * np.cos(omega * t))
        o = overlap + closer(u, top[0])
        pressed = np.maximum(o, 0)
        stiff = delta * constant * pressed ** (delta - 1)
        closing = closer(v, top[1])
        force = constant * pressed**delta - rest + viscosity * stiff * closing
        pull = (push - np.diff(force, axis=0)) / mass - drag * v
        du, dv = np.split(y[:, 1:], 2)
        # The derivative d stiff / do is infinite at an opening.
        bend = np.zeros_like(o)
        closed = o > 0
        curve = delta * (delta - 1) * constant * np.where(closed, o, 1) ** (delta - 2)
        bend[closed] = curve[closed]
        change = (stiff + viscosity * bend * closing) * closer(du, 0) + viscosity * stiff * closer(
            dv, 0
        )
        pulled = -np.diff(change, axis=0) / mass - drag * dv
        return np.hstack((np.concatenate((v, pull)), np.concatenate((dv, pulled))))

    return move


def start_of(orbit: Orbit) -> tuple[np.ndarray, np.ndarray]:
    """Return the state of the moving grains relative to its scales, and the scales, (2M, 1)."""
    free = orbit.flow.free
    state = np.concatenate((orbit.displacement[free], orbit.velocity[free]))[:, None]
    scale = np.abs(state.reshape(2, -1)).max(1).repeat(state.size // 2)[:, None]
    return state / scale, scale


def moved(orbit: Orbit, begin: np.ndarray, period: float | None = None) -> np.ndarray:
    """Return a relative state, and deviations from it, (2M, 1 + C), after a period by SciPy."""
    move = rate(orbit)
    _, scale = start_of(orbit)

    def slopes(t: float, y: np.ndarray) -> np.ndarray:
        return np.asarray(move(t, y.reshape(begin.shape) * scale) / scale).ravel()

    period = period or orbit.period
    run = solve_ivp(slopes, (0, period), begin.ravel(), "DOP853", rtol=3e-14, atol=1e-14)
    return np.asarray(run.y[:, -1].reshape(begin.shape))


def misses(orbit: Orbit) -> float:
    """Return the relative closure error of an orbit, integrated by SciPy with velocities."""
    begin, _ = start_of(orbit)
    return float(np.abs(moved(orbit, begin) - begin).max())


DRIVES = {
    "grain": Drive(amplitude=1e-8, frequency=9e3),
    "wall": Drive(amplitude=1e-8, frequency=9e3, grain=0),
    "force": Force(grain=2, amplitude=1e-2, frequency=9e3),
}


@pytest.mark.parametrize("kind", DRIVES)
def test_the_response_of_a_linear_chain_is_exact(kind: str):
    """(K (1 + i w A) - w^2 M + i w gamma M) u = f is solved as a dense system."""
    chain = TRIMER.replace(exponent=1.0, top="wall" if kind == "wall" else "free")
    drive = DRIVES[kind]
    # The guess is wrong, so that Newton's method must iterate.
    off = Profile(displacement=[0, 1e-9, 0, 0], velocity=np.zeros(4))
    orbit = orbits.find(chain, off, drive=drive)
    omega = 2 * np.pi * drive.frequency
    complex_stiffness = chain.contacts.stiffness * (1 + 1j * omega * chain.contact_viscosity)
    ends = np.diff(np.eye(6), axis=0)  # Contacts of the walls and all grains.
    matrix = ends.T @ np.diag(complex_stiffness) @ ends
    inertia = chain.masses * (omega**2 - 1j * omega * chain.drag)
    matrix[1:-1, 1:-1] -= np.diag(inertia)
    held = {"grain": [0, 1, 5], "wall": [0, 5], "force": [0, 5]}[kind]
    free = [n for n in range(6) if n not in held]
    answer = np.zeros(6, complex)
    if kind != "force":
        answer[held[-2]] = drive.amplitude
    pull = -matrix @ answer
    pull[2] += drive.amplitude * (kind == "force")
    answer[free] = np.linalg.solve(matrix[np.ix_(free, free)], pull[free])
    times, u, v = orbit.motion()
    turning = answer[1:-1] * np.exp(1j * omega * times)[:, None]
    bound = 1e-11 * np.abs(answer).max()
    np.testing.assert_allclose(u, turning.imag, atol=bound, rtol=0)
    np.testing.assert_allclose(v, omega * turning.real, atol=omega * bound, rtol=0)
    # The state at t = 0, in which a driven grain has the velocity of the drive.
    np.testing.assert_allclose(orbit.displacement, answer[1:-1].imag, atol=bound, rtol=0)
    start = omega * answer[1:-1].real
    np.testing.assert_allclose(orbit.velocity, start, atol=omega * bound, rtol=0)
    # No small change of the state moves a driven grain.
    changes = orbit.flow.deviation(orbit.state, np.ones_like(orbit.state))
    assert [bool(change[0]) for change in changes] == [kind != "grain"] * 2
    overlap = np.diff(np.pad(turning.imag, ((0, 0), (1, 1))), axis=1)
    if kind == "wall":
        overlap[:, 0] -= drive.amplitude * np.sin(omega * times)
    assert (np.abs(overlap).max(0) < chain.contacts.overlap)[chain.contacts.exists].all()
    assert orbit.residual < 1e-12
    assert orbit.error < 1e-12
    assert orbit.stable


def test_multipliers_of_a_linear_chain_agree_with_its_modes():
    """exp((-d +- i sqrt(w^2 - d^2)) T) with d = (A w^2 + gamma) / 2 for undamped frequencies w."""
    damping = {"viscoelastic": 4e-6, "drag": 3000.0}
    chain = Chain(grains=5, material="steel", exponent=1.0, damping=damping, **LEVEL)
    force = Force(grain=2, amplitude=1e-3, frequency=2e4)
    orbit = orbits.find(chain, drive=force)
    size = chain.movable
    stiffness = chain.contacts.stiffness[1 : size + 1]
    matrix = np.diag(stiffness + np.append(0.0, stiffness[:-1]))
    matrix -= np.diag(stiffness[:-1], 1) + np.diag(stiffness[:-1], -1)
    square = np.linalg.eigvalsh(matrix / chain.masses[0])
    decay = (4e-6 * square + 3000.0) / 2
    frequency = np.sqrt((square - decay**2).astype(complex))
    exponents = np.concatenate((-decay + 1j * frequency, -decay - 1j * frequency))
    expected = np.sort_complex(np.exp(exponents / 2e4))
    assert np.sort_complex(orbit.multipliers) == pytest.approx(expected, abs=1e-11)
    assert (np.diff(np.abs(orbit.multipliers)) < 1e-11).all()
    with pytest.raises(InputError, match=r"^means: a damped chain has no pairs of multipliers"):
        _ = orbit.means


@pytest.mark.parametrize("kind", DRIVES)
def test_multipliers_and_forces_agree_with_the_equation_of_motion(kind: str):
    """The variational equations by SciPy share only Eq. (1).

    The forces of all contacts are K o^(3/2) and their viscous parts, written out.
    """
    chain = TRIMER.replace(top="wall" if kind == "wall" else "free")
    drive = DRIVES[kind].replace(amplitude={"grain": 8e-6, "wall": 4e-7, "force": 6.0}[kind])
    orbit = orbits.find(chain, drive=drive)
    contacts = chain.contacts
    changes = orbit.forces()[:, contacts.exists] / contacts.force[contacts.exists] - 1
    assert -1 < changes.min() < -0.2  # The motion is nonlinear, and no contact opens.
    begin, _ = start_of(orbit)
    end = moved(orbit, np.hstack((begin, np.eye(begin.size))))
    assert np.abs(end[:, :1] - begin).max() < 1e-10
    expected = np.sort_complex(np.linalg.eigvals(end[:, 1:]))
    assert np.sort_complex(orbit.multipliers) == pytest.approx(expected, abs=1e-10)
    time, u, v = orbit.motion()
    u, v = (np.pad(x, ((0, 0), (1, 1))) for x in (u, v))
    if kind == "wall":
        phase = 2 * np.pi * drive.frequency * time
        u[:, 0] = drive.amplitude * np.sin(phase)
        v[:, 0] = 2 * np.pi * drive.frequency * drive.amplitude * np.cos(phase)
    overlap = np.maximum(contacts.overlap - np.diff(u, axis=1), 0.0)
    viscous = chain.contact_viscosity * 1.5 * np.sqrt(overlap) * -np.diff(v, axis=1)
    force = contacts.constant * (overlap**1.5 + viscous)
    exists = contacts.exists
    np.testing.assert_allclose(orbit.forces()[:, exists], force[:, exists], rtol=1e-9)
    for number in np.flatnonzero(exists):
        half = np.ptp(force[:, number]) / 2
        assert orbit.response(f"force:{number}") == pytest.approx(half, rel=1e-9)


def test_multipliers_do_not_depend_on_the_number_of_steps():
    """Contacts may open."""
    chain = TRIMER.replace(exponent=1.5)
    drive = Drive(amplitude=2 * float(chain.contacts.overlap[1]), frequency=9e3)
    orbit = orbits.find(chain, drive=drive)
    contacts = chain.contacts
    assert (contacts.overlap + contacts.closer(orbit.motion()[1]))[:, 1:].min() < 0
    size = orbit.state.size
    for many in (2, 3):
        mesh = np.repeat(orbit.mesh, many) / many
        passage = orbit.flow.run(orbit.state, orbit.period, mesh, np.eye(size).reshape(2, -1, size))
        finer = np.sort_complex(np.linalg.eigvals(passage.deviation.reshape(size, size)))
        assert np.sort_complex(orbit.multipliers) == pytest.approx(finer, abs=1e-9)
    assert misses(orbit) < 1e-8


@pytest.mark.parametrize("amplitude", thinned([7.5e-7, 1e-5], 2))
def test_a_strong_drive_is_reached_by_weaker_ones(amplitude: float):
    """Contacts open, so that the linear response is no suitable guess."""
    drive = Drive(amplitude=amplitude, frequency=9e3, grain=0)
    orbit = orbits.find(TRIMER.replace(top="wall"), drive=drive)
    assert orbit.drive.amplitude == amplitude
    assert orbit.drive.frequency == pytest.approx(9e3, rel=1e-14)
    assert orbit.forces().min() <= 0
    assert orbit.residual < 1e-12
    assert misses(orbit) < 1e-8


def test_long_runs_converge_to_the_branch():
    """A native run that begins 1 % off converges to each of two stable orbits."""
    family = resonance()
    assert family.reached
    stable = np.flatnonzero(family.stable)
    for number in stable[np.linspace(0, stable.size - 1, 2).astype(int)]:
        orbit = family[int(number)]
        # The slowest multiplier bounds the duration of a deviation.
        periods = int(np.ceil(np.log(1e-12) / np.log(abs(orbit.multipliers[0]))))
        scene = orbit.scene(periods, samples=2)
        start = scene.excitation.start
        off = Profile(displacement=1.01 * start.displacement, velocity=1.01 * start.velocity)
        drive = scene.excitation.replace(start=off)
        run = simulate(scene.replace(excitation=drive), "native", 1e-9)
        largest = np.abs(orbit.motion()[2]).max(), orbit.amplitude
        assert np.abs(run.displacement[-1] - orbit.displacement).max() < 1e-8 * largest[1]
        assert np.abs(run.velocity[-1] - orbit.velocity)[1:].max() < 1e-8 * largest[0]


def test_a_resonance_has_two_folds_with_an_unstable_stretch_between():
    family = resonance()
    assert [event.kind for event in family.events] == ["fold", "fold"]
    for event in family.events:
        assert np.abs(event.orbit.multipliers - 1).min() < 1e-4
    first = family.events[0].after
    last = family.events[1].after
    between = np.arange(len(family))
    np.testing.assert_array_equal(family.stable, (between <= first) | (between > last))
    # The mean logarithm of the multipliers is determined by the drag.
    for orbit in family:
        product = np.log(np.abs(orbit.multipliers)).sum()
        assert product == pytest.approx(-2000.0 * orbit.period, rel=1e-9)


def test_a_period_doubling_is_located_between_distant_orbits():
    """The multipliers are complex at first, so that their distance from -1 is unknown there."""
    chain = ONE.replace(damping={"drag": 300.0, "viscoelastic": 2e-9})
    drive = Drive(amplitude=0.3 * OVERLAP, frequency=1.95 * OMEGA / (2 * np.pi))
    family = orbits.follow(orbits.find(chain, drive=drive), "drive.amplitude", 0.6 * OVERLAP)
    (event,) = family.events
    assert event.kind == "period doubling"
    assert np.abs(event.orbit.multipliers + 1).min() < 1e-7
    branch = orbits.switch(event)
    assert branch.period == pytest.approx(2 * event.orbit.period, rel=1e-12)
    assert branch.drive.frequency == pytest.approx(drive.frequency, rel=1e-12)
    assert misses(branch) < 1e-8
    # An orbit without a multiplier of -1 has no such branch.
    with pytest.raises(RunFailed, match="no orbit of twice the period was found near"):
        orbits.switch(replace(event, orbit=family[0], value=float(family.value[0])))
    flow = replace(branch.flow, cycles=1)
    half = flow.run(branch.state, branch.period / 2, np.full(100, 0.01)).end
    assert np.abs(half - branch.state).max() > 0.01 * np.abs(branch.state).max()


@pytest.mark.slow
def test_a_period_doubling_is_located_and_its_branch_has_twice_the_period():
    """The event is at det(A + 1) = 0, and the doubled orbit closes, both by SciPy."""
    chain = ONE.replace(damping={"drag": 300.0, "viscoelastic": 2e-9})
    drive = Drive(amplitude=0.3 * OVERLAP, frequency=1.95 * OMEGA / (2 * np.pi))
    family = orbits.follow(orbits.find(chain, drive=drive), "drive.amplitude", OVERLAP)
    (event,) = (event for event in family.events if event.kind == "period doubling")
    assert np.abs(event.orbit.multipliers + 1).min() < 1e-5

    def excess(amplitude: float) -> float:
        orbit = orbits.find(chain, event.orbit, drive=drive.replace(amplitude=amplitude * OVERLAP))
        begin = np.hstack((start_of(orbit)[0], np.eye(2)))
        return float(np.linalg.det(moved(orbit, begin)[:, 1:] + np.eye(2)))

    # The determinant changes its sign within 1e-6 of the event.
    near = event.value / OVERLAP * np.array([1 - 1e-6, 1 + 1e-6])
    assert excess(near[0]) * excess(near[1]) < 0
    branch = orbits.switch(event)
    assert branch.period == pytest.approx(2 * event.orbit.period, rel=1e-12)
    assert branch.drive.frequency == pytest.approx(drive.frequency, rel=1e-12)
    state, _ = start_of(branch)
    half = moved(branch, state, branch.period / 2)
    assert np.abs(half - state).max() > 0.01 * np.abs(state).max()
    assert np.abs(moved(branch, half, branch.period / 2) - state).max() < 1e-9
    # A branch that continues below its family is unstable there.
    assert branch.stable == (branch.drive.amplitude > event.value)
    later = orbits.follow(branch, "drive.amplitude", OVERLAP)
    assert later.reached
    assert later[-1].period == branch.period
    assert later[-1].stable
    assert not family[-1].stable
    with pytest.raises(InputError, match=r'^event: must be a "period doubling"'):
        orbits.switch(resonance().events[0])


def test_a_branch_starts_at_a_period_doubling_without_a_drive():
    """The mode of a dimer gets twice the period and slightly more energy, and closes."""
    dimer = Chain(grains=9, material=["steel", "ptfe"] * 4 + ["steel"], **LEVEL)
    family = orbits.mode_family(dimer, 5, 8.5e-4)
    event = next(event for event in family.events if event.kind == "period doubling")
    branch = orbits.switch(event)
    assert branch.residual < 1e-12
    assert branch.period == pytest.approx(2 * event.orbit.period, rel=1e-3)
    half = branch.flow.run(branch.state, branch.period / 2, np.full(100, 0.01)).end
    assert np.abs(half - branch.state).max() > 0.01 * np.abs(branch.state).max()


@pytest.mark.parametrize(
    ("parameter", "until"),
    [
        ("drive.frequency", 9.3e3),
        ("drive.amplitude", 3e-8),
        ("chain.top_load", 25.0),
        ("damping.drag", 100.0),
        ("damping.drag[2]", 100.0),
        ("damping.viscoelastic", 0.0),
        ("masses[2]", 2e-3),
    ],
)
def test_parameters_of_drive_chain_and_damping_are_continued(parameter: str, until: float):
    """The last orbit is an orbit of the drive and the chain with the final parameter."""
    chain = TRIMER.replace(damping={"viscoelastic": 1e-7, "drag": 400.0})
    if "[" in parameter:
        chain = TRIMER
    drive = DRIVES["grain"]
    family = orbits.follow(orbits.find(chain, drive=drive), parameter, until)
    assert family.reached
    assert family.value[-1] == pytest.approx(until, rel=1e-12, abs=1e-20)
    room, _, name = parameter.rpartition(".")
    last_drive = drive.replace(**{name: until}) if room == "drive" else drive
    damping = chain.damping
    if name == "drag[2]":
        damping = damping.replace(drag=np.where(np.arange(4) == 1, until, damping.drag))
    elif room == "damping":
        damping = damping.replace(**{name: until})
    last = chain.replace(damping=damping)
    if room == "chain":
        last = last.replace(**{name: until})
    elif not room:
        last = last.replace(masses=np.where(np.arange(4) == 1, until, chain.masses))
    expected = orbits.find(last, drive=last_drive)
    bound = 1e-9 * expected.amplitude
    np.testing.assert_allclose(family[-1].displacement, expected.displacement, atol=bound, rtol=0)
    assert family[-1].multipliers == pytest.approx(expected.multipliers, abs=1e-8)


def test_directions_and_forces_of_a_damped_orbit_agree_with_its_motion():
    family = resonance()
    orbit = family[family.events[0].after + 1]
    assert orbit.unstable.size == 1
    u, v = orbit.direction()
    size = 1e-7 * orbit.amplitude
    begin, scale = start_of(orbit)
    change = size * np.array([[u[1]], [v[1]]]) / scale
    growth = ((moved(orbit, begin + change) - moved(orbit, begin)) / change)[:, 0]
    assert growth == pytest.approx(orbit.unstable.real.repeat(2), rel=1e-4)
    chain = orbit.chain
    _, u, _ = orbit.motion()
    overlap = chain.contacts.overlap[1] + u[:, 0] - u[:, 1]
    force = chain.contacts.constant[1] * np.maximum(overlap, 0) ** 1.5
    np.testing.assert_allclose(orbit.forces()[:, 1], force, rtol=1e-12)
    assert orbit.response("force:1") == pytest.approx(np.ptp(force) / 2, rel=1e-12)
    assert orbit.response("displacement:2") == pytest.approx(np.ptp(u[:, 1]) / 2, rel=1e-12)
    assert orbit.response() == np.abs(u).max()


def test_a_resonance_curve_is_drawn_through_its_folds():
    family = resonance()
    ax = family.plot(of="force:1")
    lines = {line.get_label(): line for line in ax.lines}
    assert list(lines) == ["stable", "unstable", "fold"]
    assert lines["unstable"].get_linestyle() == ":"
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        "frequency of the drive",
        "force of contact 1, half of its range",
    )
    x, y = lines["stable"].get_data()
    assert x.size == len(family) + 2
    folds = lines["fold"].get_xydata()
    for place, (fx, fy) in zip((1, 2), folds, strict=True):
        at = family.events[place - 1].after + place
        assert (x[at], y[at]) == (fx, fy)
    assert np.isnan(y).any()
    np.testing.assert_allclose(folds[:, 0], [event.value for event in family.events])
    columns = list(family.to_dataframe())
    sizes = ["period [s]", "energy [J]", "amplitude [m]"]
    assert columns == ["drive.frequency [Hz]", *sizes, "stable"]
    by_load = orbits.follow(family[0], "drive.amplitude", 0.06 * OVERLAP).plot()
    assert by_load.get_xlabel() == "amplitude of the drive"
    assert by_load.get_ylabel() == "largest displacement"
    assert ax.get_yscale() == "log"  # The resonance is more than 50 times as high as its foot.
    assert (by_load.get_yscale(), by_load.get_ylim()[0]) == ("linear", 0.0)
    assert by_load.yaxis.get_minorticklocs().size


@pytest.mark.soak
def test_two_hundred_orbits_of_81_grains_take_less_than_a_minute():
    """One core follows a family through resonances of the upper band of a dimer."""
    level = LEVEL | {"grains": 81, "damping": {"drag": 500.0}}
    chain = Chain(material=["steel", "ptfe"] * 40 + ["steel"], **level)
    drive = Drive(amplitude=0.003 * float(chain.contacts.overlap[1]), frequency=6.7e3)
    first = orbits.find(chain, drive=drive)
    begin = time.process_time()
    family = orbits.follow(first, "drive.frequency", 9.9e3)
    taken = time.process_time() - begin
    assert family.reached
    assert len(family) > 100
    assert taken / len(family) * 200 < 60
    assert max(orbit.residual for orbit in family) < 1e-12


def test_the_scene_of_a_forced_orbit_is_periodic(tmp_path):
    """The force starts with all grains in motion, and acts on a later grain."""
    orbit = orbits.find(TRIMER, drive=Force(grain=2, amplitude=5.0, frequency=9e3))
    scene = orbit.scene(10, samples=11)
    run = simulate(scene, "native", 1e-11)
    # Errors are relative to the largest motion of the run, which is larger than the initial motion.
    assert np.abs(run.displacement - orbit.displacement).max() < 1e-11 * orbit.amplitude
    assert np.abs(run.velocity - orbit.velocity).max() < 1e-11 * np.abs(orbit.velocity).max()
    scene.to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == scene
    again = orbits.find(TRIMER, drive=scene.excitation)
    assert again.iterations <= 2
    np.testing.assert_allclose(again.displacement, orbit.displacement, rtol=1e-9)


@pytest.mark.parametrize(("engine", "tolerance"), [("lammps", 1e-5), ("native", 1e-9)])
def test_engines_know_the_forced_grain_if_others_move_earlier(engine: str, tolerance: float):
    chain = TRIMER.replace(damping=Damping())
    orbit = orbits.find(chain, drive=Force(grain=3, amplitude=0.5, frequency=9e3))
    run = simulate(orbit.scene(2, samples=3), engine, tolerance)
    off = np.abs(run.displacement - orbit.displacement).max()
    assert off < 2 * tolerance * orbit.amplitude
    off = np.abs(run.velocity - orbit.velocity).max()
    assert off < 2 * tolerance * np.abs(orbit.velocity).max()


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_modes_include_the_initial_motion_of_a_forced_scene(exponent: float):
    """The orbit agrees with the native integrator for weak motion."""
    chain = TRIMER.replace(exponent=exponent, damping={"viscoelastic": 2e-7, "drag": 500.0})
    orbit = orbits.find(chain, drive=Force(grain=3, amplitude=1e-9, frequency=9e3))
    scene = orbit.scene(1.25, samples=6)
    runs = [simulate(scene, engine, 1e-8) for engine in ("modes", "native")]
    size = np.abs(runs[1].displacement).max()
    assert np.abs(runs[0].displacement - runs[1].displacement).max() < 1e-8 * size


def test_a_start_of_another_length_is_rejected():
    force = Force(grain=2, amplitude=1.0, frequency=9e3, start=Profile(velocity=[0.0, 1e-3]))
    with pytest.raises(InputError, match=r"^start\.velocity: must have one entry a grain"):
        Scene(chain=TRIMER, excitation=force, duration=1e-3)


def test_invalid_damped_orbits_are_rejected():
    sine = DRIVES["grain"]
    pushed = orbits.find(TRIMER, drive=DRIVES["force"])
    cases: dict[str, Any] = {
        r"^chain.damping: damping brings .* to rest: give a drive": lambda: Flow(TRIMER, 1e5),
        r"^drive: must be a Drive or a Force": lambda: orbits.find(
            TRIMER, drive=Profile(velocity=np.zeros(4))
        ),
        r"^drive: must be a sine": lambda: orbits.find(
            TRIMER, drive=Force(grain=1, shape="half-sine", amplitude=1.0, duration=1e-5)
        ),
        r"^of: the contacts are numbered 1 to 4": lambda: pushed.response("force:5"),
        r"^of: the contacts are numbered 1 to 4 ": lambda: pushed.response("force:0"),
        r"^of: the grains are numbered 1 to 4": lambda: pushed.response("displacement:5"),
        r"^of: the grains are numbered 1 to 4 ": lambda: pushed.response("displacement:0"),
        r'^of: must be "amplitude"': lambda: pushed.response("energy"),
        r"^parameter: must be period, a number of the drive": lambda: orbits.follow(
            pushed, "damping.friction", 1.0
        ),
        r"^damping.drag": lambda: orbits.follow(
            orbits.find(TRIMER.replace(damping={"drag": 1.0}), drive=sine), "damping.drag", -1.0
        ),
    }
    for message, call in cases.items():
        with pytest.raises(InputError, match=message):
            call()
