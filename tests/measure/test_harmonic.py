"""Waves and responses of harmonically driven chains, against exact solutions and SciPy."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.example_scenes import run
from helpers.thinned import thinned
from scipy.integrate import solve_ivp
from scipy.optimize import root

from lmpchain import Chain, Drive, Force, InputError, Law, Trajectory, patterns, simulate
from lmpchain.measure import harmonic

LOADED = {"material": "steel", "diameter": 1e-2, "gravity": 0.0, "top_load": 20.0}


def driven(chain: Chain, drive: Drive | Force, periods: float, samples: int = 24) -> Trajectory:
    """Simulate a chain for a number of periods of its drive."""
    assert drive.frequency
    duration = periods / drive.frequency
    return run(chain, drive, duration, 1 + round(samples * periods), 1e-8)


def exact_linear(chain: Chain, omega: float, viscoelastic: float, drag: float) -> complex:
    """Return phase + i decay per grain of a wave that travels down a linear chain."""
    stiffness = chain.linear_stiffness[0] * (1 + 1j * omega * viscoelastic)
    k = np.arccos(1 - chain.masses[0] * (omega**2 - 1j * omega * drag) / (2 * stiffness))
    k = k if k.imag < 0 or (k.imag == 0 and k.real > 0) else -k
    return complex(k.real, -k.imag)


def travelling_wave(
    chain: Chain, omega: float, amplitude: float, strain: float, harmonics: int = 6
) -> float:
    """Return the phase per grain of the periodic travelling wave of an infinite Hertzian chain.

    Its displacement is a Fourier series of the phase, with the given amplitude of the fundamental,
    in a chain whose mean overlap is larger than at rest by `strain`. Newton's method solves the
    advance-delay equation for the coefficients and the phase per grain.
    """
    mass = chain.masses[0]
    constant = chain.contact_constants[0]
    rest = chain.equilibrium_overlap[0]
    mean = rest * (1 + strain)
    order = np.arange(1, harmonics + 1)
    phase = 2 * np.pi * np.arange(8 * harmonics) / (8 * harmonics)
    cosine, sine = (f(np.outer(phase, order)) for f in (np.cos, np.sin))

    def residual(unknown: np.ndarray) -> np.ndarray:
        k = unknown[0]
        even = amplitude * np.append(1.0, unknown[1:harmonics])
        odd = amplitude * np.append(0.0, unknown[harmonics:])

        def at(lag: float) -> np.ndarray:
            turned = np.outer(phase - lag, order)
            return np.cos(turned) @ even + np.sin(turned) @ odd

        above = constant * (mean + at(-k) - at(0.0)) ** chain.exponent
        below = constant * (mean + at(0.0) - at(k)) ** chain.exponent
        inertia = mass * omega**2 * ((cosine * order**2) @ even + (sine * order**2) @ odd)
        off = (inertia + above - below) / (constant * rest ** (chain.exponent - 1) * amplitude)
        return np.concatenate((cosine.T @ off, (sine.T @ off)[1:])) / phase.size

    guess = np.zeros(2 * harmonics - 1)
    guess[0] = exact_linear(chain, omega, 0.0, 0.0).real
    found = root(residual, guess, tol=1e-13)
    assert np.abs(found.fun).max() < 1e-11
    return float(found.x[0])


def test_errors_cover_the_exact_linear_dispersion(rng: np.random.Generator) -> None:
    """Phase and decay of random damped chains are right within their errors."""
    for number in range(4):
        exponent = float(rng.choice([1.3, 1.5, 2.0]))
        plain = Chain(grains=60, bottom="wall", exponent=exponent, **LOADED)
        omega = plain.band_edge * rng.uniform(0.2, 0.9)
        losses = {"viscoelastic": 3e-3 / omega, "drag": 1e-3 * omega} if number % 2 else None
        lossy = plain.replace(damping=losses)
        small = 1e-6 * plain.equilibrium_overlap[0]
        source: Drive | Force = Drive(amplitude=small, frequency=omega / 2 / np.pi)
        if number >= 2:
            push = small * plain.linear_stiffness[0]
            source = Force(grain=2, amplitude=push, frequency=omega / 2 / np.pi)
        found = harmonic.wave(driven(patterns.absorbing(lossy, bottom=60), source, 110))
        exact = exact_linear(plain, omega, *(losses.values() if losses else (0.0, 0.0)))
        assert found.linear_phase == pytest.approx(exact.real, rel=1e-10)
        assert abs(found.linear_decay - exact.imag) < 1e-12
        assert abs(found.phase - exact.real) < 2 * found.phase_error < 1e-5
        assert abs(found.decay - exact.imag) < 2 * found.decay_error < 1e-5


@cache
def long_run(exponent: float, amplitude: float) -> Trajectory:
    """Simulate a long chain, from whose end nothing has come back."""
    chain = Chain(grains=400, exponent=exponent, **LOADED)
    drive = Drive(
        amplitude=amplitude * float(chain.equilibrium_overlap[0]),
        frequency=0.5 * chain.band_edge / 2 / np.pi,
    )
    return driven(chain, drive, 80)


@pytest.mark.parametrize(("exponent", "amplitude"), thinned(product([1.5, 2.0], [0.02, 0.1]), 3))
def test_strong_waves_have_the_phase_of_exact_travelling_waves(
    exponent: float, amplitude: float
) -> None:
    """The shift by amplitude agrees with periodic travelling waves of the same mean strain."""
    t = long_run(exponent, amplitude)
    chain = t.scene.chain
    found = harmonic.wave(t)
    omega = 2 * np.pi * found.frequency
    size = float(np.abs(found.amplitude).mean())
    exact, squeezed = (
        travelling_wave(chain, omega, size, strain)
        for strain in (found.strain, found.strain + found.strain_error)
    )
    error = found.phase_error + abs(squeezed - exact)
    shift = abs(exact - found.linear_phase)
    assert abs(found.phase - exact) < error < 0.2 * shift


def test_errors_include_the_error_of_the_trajectory() -> None:
    """An error e of all displacements changes cos k by (4/pi) e (1 + |cos k|) / a at most."""
    t = long_run(1.5, 0.02)
    chain = t.scene.chain
    known, unsure = (harmonic.wave(of_error(t, error)) for error in (0.0, 1e-3))
    off = 4 / np.pi * 1e-3 * np.abs(t.displacement).max()
    change = off * (1 + np.cos(known.phase)) / np.abs(unsure.amplitude).mean()
    for name in ("phase", "decay"):
        more = getattr(unsure, f"{name}_error") - getattr(known, f"{name}_error")
        assert more == pytest.approx(change / np.sin(known.phase), rel=0.1)
    more = unsure.strain_error - known.strain_error
    assert more == pytest.approx(2 * off / chain.equilibrium_overlap[0], rel=0.1)


def test_phase_and_strain_of_a_given_motion() -> None:
    """A phase lag and a static displacement that are not linear differ between two parts."""
    t = long_run(1.5, 0.02)
    rest = float(t.scene.chain.equilibrium_overlap[0])
    omega = 2 * np.pi * t.scene.excitation.frequency
    lag = 0.9 * t.grains + 4e-6 * t.grains**3
    static = -rest * (1e-3 * t.grains + 1e-6 * t.grains**2)
    size = 0.1 * rest * np.exp(-5e-3 * t.grains)
    motion = size * np.cos(omega * t.time[:, None] - lag) + static
    found = harmonic.wave(of_error(replace(t, displacement=motion)), first=5, last=61)
    chosen = found.grain - 1
    assert found.grain.tolist() == list(range(5, 62))
    amplitude = (size * np.exp(-1j * lag))[chosen]
    assert np.abs(found.amplitude - amplitude).max() < 1e-9 * rest

    def cosine(a: np.ndarray) -> complex:
        return complex(np.linalg.lstsq(2 * a[1:-1, None], a[:-2] + a[2:])[0][0])

    # The parts have half of the sum of the squares of the inner amplitudes.
    squares = np.cumsum(np.abs(amplitude[1:-1]) ** 2)
    half = int((squares >= squares[-1] / 2).argmax())
    parts = (amplitude, amplitude[: half + 2], amplitude[half:])
    whole, early, late = (cosine(a) for a in parts)
    exact = np.arccos(whole)
    assert found.phase == pytest.approx(exact.real, rel=1e-9)
    assert found.decay == pytest.approx(abs(exact.imag), rel=1e-6)
    error = abs(early - late) / abs(np.sin(exact))
    assert found.phase_error == pytest.approx(error, rel=0.01)
    assert found.decay_error == pytest.approx(error, rel=0.01)
    strain = -np.diff(static[chosen]) / rest
    assert found.strain == pytest.approx(strain.mean(), rel=1e-6)
    change = abs(strain[:28].mean() - strain[28:].mean())
    assert found.strain_error == pytest.approx(change, rel=1e-3)
    (line, slope, zero), plotted = found.plot().lines, np.arange(57)
    deviation = lag[chosen] - lag[4] - found.linear_phase * plotted
    assert line.get_ydata() == pytest.approx(deviation, abs=1e-6)
    assert slope.get_ydata() == pytest.approx((found.phase - found.linear_phase) * plotted)
    assert not np.any(zero.get_ydata())


def test_a_gap_is_measured_as_a_decay() -> None:
    """In the gap of a dimer and above the band the amplitude decays as in linear theory."""
    dimer = patterns.periodic(
        60, 1e-2, ["steel", "aluminium"], gravity=0.0, top_load=20.0, bottom="wall"
    )
    stiffness = dimer.linear_stiffness[0]
    light, heavy = sorted(dimer.masses[:2])
    for omega, cell in (
        (np.sqrt(stiffness * (1 / light + 1 / heavy)), 2),
        (0.9 * np.sqrt(2 * stiffness / heavy), 2),
    ):
        small = 1e-6 * dimer.equilibrium_overlap[0]
        drive = Drive(amplitude=small, frequency=omega / 2 / np.pi)
        found = harmonic.wave(
            driven(patterns.absorbing(dimer, bottom=60), drive, 150), last=50, cell=cell
        )
        cosine = 1 + (
            light * heavy * omega**4 / (2 * stiffness**2) - (light + heavy) * omega**2 / stiffness
        )
        exact = np.arccos(complex(cosine))
        assert found.linear_decay == pytest.approx(abs(exact.imag), abs=1e-9)
        assert abs(found.decay - abs(exact.imag)) < 2 * found.decay_error < 2e-3
        off = np.angle(np.exp(1j * (found.phase - exact.real)))
        assert abs(off) < 2 * found.phase_error < 2e-3


def test_a_cell_of_three_grains_on_a_ground() -> None:
    """Phase and decay of a damped trimer follow from the determinant of its unit cell."""
    losses = {"viscoelastic": 2e-6, "drag": 3e3}
    chain = Chain(
        grains=48,
        masses=np.tile([4e-3, 6e-3, 3e-3], 16),
        contact_constants=np.tile([1e10, 2e10, 0.6e10], 16)[:-1],
        ground=Law("k*u", k=4e6),
        damping=losses,
        **LOADED,
    )
    omega = 0.2 * chain.band_edge
    small = 1e-6 * float(chain.equilibrium_overlap.min())
    drive = Drive(amplitude=small, frequency=omega / 2 / np.pi)
    found = harmonic.wave(driven(chain, drive, 100), cell=3)
    springs = chain.linear_stiffness[:3] * (1 + 1j * omega * losses["viscoelastic"])
    inner = 4e6 - chain.masses[:3] * (omega**2 - 1j * omega * losses["drag"])

    def determinant(turn: float) -> complex:
        cell = np.diag(springs + np.roll(springs, 1) + inner)
        cell -= np.diag(springs[:2], 1) + np.diag(springs[:2], -1)
        cell[[0, 2], [2, 0]] -= springs[2] * turn
        return complex(np.linalg.det(cell))

    # The determinant is linear in cos(k), which is 1 and -1 for these turns.
    ends = determinant(1.0), determinant(-1.0)
    exact = np.arccos((ends[0] + ends[1]) / (ends[1] - ends[0]))
    exact *= -np.sign(exact.imag)
    assert found.linear_phase == pytest.approx(exact.real, rel=1e-9)
    assert found.linear_decay == pytest.approx(-exact.imag, rel=1e-9)
    assert abs(found.phase - exact.real) < 2 * found.phase_error < 1e-3
    assert abs(found.decay + exact.imag) < 2 * found.decay_error < 1e-3
    assert found.cell == 3


@pytest.mark.parametrize("bottom", ["wall", "fixed"])
@pytest.mark.parametrize("seed", range(3))
def test_drive_point_of_a_base_under_gravity(
    rng: np.random.Generator, bottom: str, seed: int
) -> None:
    """A column on a shaker, against a dense linear system of all bodies."""
    grains = int(rng.integers(1 if bottom == "wall" else 2, 20))
    chain = Chain(
        grains=grains,
        diameter=5e-3 * rng.uniform(0.8, 1.2, grains),
        bottom=bottom,
        damping={"viscoelastic": 2e-6, "drag": 200.0},
    )
    frequency = float(rng.uniform(0.02, 0.3) * chain.band_edge / np.pi)
    shaker = Drive(end="bottom", amplitude=1e-15, frequency=frequency)
    omega = 2 * np.pi * frequency
    springs = chain.contacts.stiffness * (1 + 1j * omega * chain.contact_viscosity)
    matrix = np.zeros((grains + 2, grains + 2), complex)
    for n, spring in enumerate(springs):
        matrix[n : n + 2, n : n + 2] += spring * np.array([[1, -1], [-1, 1]])
    inertia = chain.masses * (-(omega**2) + 1j * omega * chain.drag)
    base = chain.movable + 1
    # No drag acts on a driven grain.
    inertia[base - 1 :] = -(omega**2) * chain.masses[base - 1 :]
    matrix[1:-1, 1:-1] += np.diag(inertia)
    free = np.arange(1, base)
    moved = -np.linalg.solve(matrix[np.ix_(free, free)], matrix[free, base])
    exact = matrix[base, base] + matrix[base, free] @ moved
    found = harmonic.drive_point(driven(chain, shaker, 400, samples=16))
    assert abs(found.linear / exact - 1) < 1e-12
    assert abs(found.stiffness - exact) <= found.error < 1e-7 * abs(exact)
    assert abs(found.stiffness / exact - 1) < 1e-9


def test_drive_point_of_linear_chains() -> None:
    """The dynamic stiffness agrees with a dense linear system, for each kind of drive."""
    losses = {"viscoelastic": 4e-6, "drag": 50.0}
    chain = Chain(grains=6, top="wall", bottom="wall", damping=losses, **LOADED)
    omega = 0.37 * chain.band_edge
    springs = chain.contacts.stiffness * (1 + 1j * omega * losses["viscoelastic"])
    matrix = np.diag(
        springs[:-1] + springs[1:] - chain.masses * (omega**2 - 1j * omega * losses["drag"])
    )
    matrix -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    by_wall = springs[0] - springs[0] ** 2 * np.linalg.inv(matrix)[0, 0]
    by_grain = 1 / np.linalg.inv(matrix)[0, 0] - chain.masses[0] * 1j * omega * losses["drag"]
    by_force = 1 / np.linalg.inv(matrix)[2, 2]
    frequency = omega / 2 / np.pi
    for drive, exact in (
        (Drive(grain=0, amplitude=1e-12, frequency=frequency), by_wall),
        (Drive(grain=1, amplitude=1e-12, frequency=frequency), by_grain),
        (Force(grain=3, amplitude=1e-5, frequency=frequency), by_force),
    ):
        found = harmonic.drive_point(driven(chain, drive, 150))
        assert abs(found.stiffness - exact) < found.error < 1e-5 * abs(exact)
        assert abs(found.linear - exact) < 1e-9 * abs(exact)
        assert found.apparent_mass == pytest.approx(-exact / omega**2, rel=1e-5)
        assert found.impedance.real > 0
        assert found.loss_factor == pytest.approx(exact.imag / abs(exact.real), rel=1e-4)
        assert found.impedance == pytest.approx(found.stiffness / (1j * omega), rel=1e-12)
        assert found.impedance_error == pytest.approx(found.error / omega, rel=1e-12)
        assert found.apparent_mass_error == pytest.approx(found.error / omega**2, rel=1e-12)
        part = found.error / abs(exact.real)
        bounds = part, 2 * part * (1 + found.loss_factor)
        assert bounds[0] <= found.loss_factor_error <= bounds[1]


@pytest.mark.slow
def test_drive_point_of_a_strongly_shaken_chain() -> None:
    """Apparent mass and loss factor of a bouncing chain agree with an independent SciPy run."""
    chain = Chain(grains=3, top="wall", bottom="wall", damping={"viscoelastic": 8e-6}, **LOADED)
    rest = float(chain.contacts.overlap[0])
    omega = 0.3 * chain.band_edge
    drive = Drive(grain=0, amplitude=0.6 * rest, frequency=omega / 2 / np.pi)
    found = harmonic.drive_point(driven(chain, drive, 160, samples=48))
    mass = chain.masses
    at_rest = chain.contacts.overlap
    constants = np.array(
        [chain.wall_constants[0], *chain.contact_constants, chain.wall_constants[1]]
    )

    def forces(t: float, state: np.ndarray) -> np.ndarray:
        u, v = np.zeros((2, 5))
        u[1:4], v[1:4] = state.reshape(2, 3)
        u[0] = drive.amplitude * np.sin(omega * t)
        v[0] = drive.amplitude * omega * np.cos(omega * t)
        overlap = np.maximum(at_rest - u[1:] + u[:-1], 0.0)
        # The force is K (1 + A d/dt) o^(3/2).
        return constants * np.sqrt(overlap) * (overlap - 8e-6 * 1.5 * (v[1:] - v[:-1]))

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        force = forces(t, state)
        return np.concatenate((state[3:], (force[:-1] - force[1:]) / mass))

    period = 2 * np.pi / omega
    time = period * (60 + np.arange(10 * 64) / 64)
    answer = solve_ivp(
        rate,
        (0, time[-1]),
        np.zeros(6),
        "DOP853",
        time,
        rtol=1e-11,
        atol=1e-16,
        max_step=period / 10,
    )
    force = np.array([forces(*each)[0] for each in zip(time, answer.y.T, strict=True)])
    fundamental = 2 * np.mean(force * np.exp(-1j * omega * time)) / (-1j * drive.amplitude)
    assert abs(found.stiffness - fundamental) < found.error + 1e-7 * abs(fundamental)
    assert found.error < 1e-4 * abs(fundamental)
    # The drive is strong: linear theory is off by far more than the error.
    assert abs(found.linear - fundamental) > max(100 * found.error, 5e-3 * abs(fundamental))


def test_errors_cover_the_rest_of_a_transient() -> None:
    """After short runs of weakly damped, strongly driven chains, a four times longer one agrees."""
    rng = np.random.default_rng(6)
    for number in range(2):
        chain = Chain(
            grains=int(rng.integers(4, 10)),
            top="wall",
            bottom="wall",
            damping={"viscoelastic": 2e-6, "drag": 100.0},
            **LOADED,
        )
        frequency = rng.uniform(0.1, 0.5) * chain.band_edge / 2 / np.pi
        size = 0.3 * float(chain.contacts.overlap[0])
        drive: Drive | Force = Drive(grain=0, amplitude=size, frequency=frequency)
        if number % 2:
            push = size * float(chain.contacts.stiffness[0])
            drive = Force(grain=2, amplitude=push, frequency=frequency)
        periods = int(rng.integers(60, 120))
        short, long = (
            harmonic.drive_point(driven(chain, drive, count)) for count in (periods, 4 * periods)
        )
        assert long.error < 1e-3 * abs(long.stiffness)
        assert abs(short.stiffness - long.stiffness) <= short.error + long.error


def test_the_error_covers_a_transient_that_hardly_decays() -> None:
    """The later half of the window changes the stiffness by a fifth of its distance from steady."""
    damping = {"viscoelastic": 8.31262e-07, "drag": 462.317}
    chain = Chain(grains=9, top="wall", bottom="wall", damping=damping, **LOADED)
    push = 0.26 * float(chain.contacts.overlap[0] * chain.contacts.stiffness[0])
    drive = Force(grain=2, amplitude=push, frequency=0.4832932 * chain.band_edge / 2 / np.pi)
    short, long = (harmonic.drive_point(driven(chain, drive, count)) for count in (145, 580))
    assert long.error < 0.01 * abs(long.stiffness)
    off = abs(short.stiffness - long.stiffness)
    assert 0.1 * abs(long.stiffness) < off <= short.error


def test_unsuitable_runs_are_rejected() -> None:
    """A burst or a few grains give no wavenumber."""
    t = long_run(1.5, 0.02)
    with pytest.raises(InputError, match="are needed"):
        harmonic.wave(t, first=10, last=14)
    with pytest.raises(InputError, match="leave grains to measure"):
        harmonic.wave(t, first=20, last=10)
    # Grains beyond a gap in the recording are left out, and so are those of another kind.
    sparse = t.scene.replace(grains=(*range(1, 31), *range(40, 60)))
    assert harmonic.wave(simulate(sparse, "native", 1e-8)).grain.max() == 30
    chain = t.scene.chain
    step = np.where(np.arange(400) == 35, 1.5, 1.0)  # Grain 36, or the contact below it, differs.
    for change in (
        {"masses": chain.masses * step},
        {"contact_constants": chain.contact_constants * step[:-1]},
        {"ground": Law("k*u", k=1e3 * step)},
        {"damping": {"drag": 1e-3 * step}},
        {"damping": {"viscoelastic": 1e-12 * step[:-1]}},
    ):
        mixed = replace(t, scene=t.scene.replace(chain=chain.replace(**change)))
        assert harmonic.wave(mixed).grain.tolist() == list(range(4, 36))
    unsure = harmonic.DrivePoint(1.0, complex(1.0, 2.0), 1.5, complex(np.nan))
    assert unsure.loss_factor_error == np.inf
    with pytest.raises(InputError, match="periods"):
        harmonic.wave(t, periods=4)
    burst = t.scene.replace(excitation=t.scene.excitation.replace(cycles=3))
    with pytest.raises(InputError, match="becomes steady"):
        harmonic.wave(simulate(burst.replace(duration=1e-4, samples=50), "native"))
