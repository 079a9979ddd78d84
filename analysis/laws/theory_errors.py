"""Measured errors of the linear, homogeneous and continuous chain; the laws are in `theories`."""

from __future__ import annotations

import warnings

import numpy as np

from lmpchain.chain.chain import Chain
from lmpchain.errors import InputError
from lmpchain.measure.front import track
from lmpchain.scene.excitation import Displacement, Drive, Excitation, Impulse, Profile
from lmpchain.scene.scene import Scene
from lmpchain.simulation.api import simulate
from lmpchain.theory import bessel, continuum
from lmpchain.theory.continuum import Complex
from lmpchain.theory.domain import real
from lmpchain.trajectory.trajectory import Trajectory
from lmpchain.util.arrays import Array

BEAD = 1e-3  # Diameter, m.
WEAK = 1e-9  # Strike number at which Eq. (1) agrees with Eq. (3).
EDGE = 8.5  # Standard deviations beyond which a Gaussian counts as 0.
SAMPLES = 20  # Samples per unit of tau.
PERIODS = 4  # Periods over which a phase is averaged.


def column(
    excitation: float | Excitation,
    tau: float,
    grains: int,
    exponent: float = 1.5,
    gravity: float = 9.81,
    load: float = 0,
) -> Scene:
    """Return a column of glass beads for a time tau, with 20 samples per unit of tau.

    Parameters
    ----------
    excitation : float or Excitation
        A number is the strike number v0* of an impulse on grain 1.
    load : float
        On grain 1, in weights of a grain.
    """
    weight = gravity * float(Chain(grains=2, diameter=BEAD).masses[0])
    chain = Chain(
        grains=grains, diameter=BEAD, exponent=exponent, gravity=gravity, top_load=load * weight
    )
    if not isinstance(excitation, Excitation):
        excitation = Impulse(velocity=excitation * chain.length_scale / chain.time_scale)
    samples = round(SAMPLES * tau) + 2
    return Scene(
        chain=chain, excitation=excitation, duration=tau * chain.time_scale, samples=samples
    )


def linear_error(scene: Scene) -> dict[str, float]:
    """Return the error of Eq. (3) in every norm of `linear_law`, against the native engine at 1e-9.

    Norms over all samples take those of the scene; "peak" is of the deepest grain that the front
    has passed, and left out if there is none.
    """
    linear = theory(scene, "chebyshev")
    full = simulate(scene, "native", 1e-9, on_miss="warn")
    errors = {
        "velocity": _distance(linear.velocity[-1], full.velocity[-1]),
        "displacement": _largest(linear.displacement, full.displacement),
    }
    errors["package"] = max(errors["displacement"], _largest(linear.velocity, full.velocity))
    try:
        fronts = [track(answer) for answer in (linear, full)]
    except InputError:
        return errors
    passed = np.intersect1d(fronts[0].grain, fronts[1].grain)
    if passed.size:
        one, other = (front.between(passed[-1], passed[-1]).amplitude[0] for front in fronts)
        errors["peak"] = float(abs(one / other - 1))
    return errors


def uniform_error(grain: int, travelled: float, width: float = 0.0) -> float:
    """Return the error of `theories.uniform_law`, against Eq. (3) in a long Hertzian column."""
    n = np.arange(1, grain + int(travelled + EDGE * width + 4 * travelled ** (1 / 3)) + 12)
    shape = np.exp(-(((n - grain) / width) ** 2) / 2) if width else (n == grain).astype(float)
    shape[np.abs(n - grain) > EDGE * max(width, 1.0)] = 0
    unit = WEAK * Chain(grains=n.size, diameter=BEAD).equilibrium_overlap[grain - 1]
    scene = column(Profile(displacement=unit * shape), travelled / grain ** (1 / 6), n.size)
    moved = shape > 0
    uniform = bessel.infinite_general(n, travelled, n[moved], shape[moved])
    return _distance(uniform, theory(_at_its_end(scene), "chebyshev").displacement[-1] / unit)


def bessel_error(load: float, tau: float) -> tuple[float, float]:
    """Return the contrast and error of `theories.bessel_law`; `load` is in grain weights."""
    scene = column(WEAK, tau, 60 + int(continuum.depth(tau) + 1.2 * tau), load=load)
    uniform, exact = (theory(scene, engine) for engine in ("bessel", "chebyshev"))
    stiffness = scene.chain.linear_stiffness
    error = max(
        _largest(uniform.displacement, exact.displacement),
        _largest(uniform.velocity, exact.velocity),
    )
    return float(stiffness[1] / stiffness[0] - 1), error


def local_error(tau: float) -> float:
    """Return the error of Eq. (7) after a displacement of grain 1, as L2 norm, at tau."""
    grains = int(1.3 * continuum.depth(tau)) + 20
    unit = WEAK * Chain(grains=grains, diameter=BEAD).length_scale
    scene = _at_its_end(column(Displacement(displacement=unit, grain=1), tau, grains))
    return _distance(
        bessel.local(np.arange(1, grains + 1), tau),
        theory(scene, "chebyshev").displacement[-1] / unit,
    )


def far_field_error(grain: int, tau: float) -> float:
    """Return the error of `theories.far_field_law`: the largest over a period before tau."""
    times = tau - np.linspace(0, np.pi / grain ** (1 / 6), 200)
    difference = bessel.far_field(grain, times) - bessel.local(grain, times)
    return float(np.abs(difference).max() * grain ** (1 / 12) * np.sqrt(np.pi * tau))


def continuum_error(width: float, tau: Array, exponent: float = 1.5, cells: int = 9) -> Array:
    """Return the error of `theories.continuum_law` at each tau, (T,), against Eq. (3).

    Eq. (27) is solved with `cells` cells a grain.
    """
    grains = int(continuum.depth(max(tau) + 6 * width, exponent)) + 20

    def strike(h: Array) -> Array:
        travel = continuum.chi(h, exponent) / width
        return np.where(travel < EDGE, np.exp(-(travel**2) / 2), 0.0)

    struck = strike(real(np.arange(grains) + 0.5))
    struck[-1] = 0
    smooth = continuum.solve(tau, grains, velocity=strike, delta=exponent, cells=cells).velocity
    unit = _unit(column(WEAK, 1.0, grains, exponent))
    scenes = [column(Profile(velocity=unit * struck), now, grains, exponent) for now in tau]
    exact = [theory(_at_its_end(scene), "chebyshev").velocity[-1] / unit for scene in scenes]
    return np.array([_distance(*pair) for pair in zip(smooth, exact, strict=True)])


def impulse_error(tau: float, samples: int = 2) -> tuple[Array, Array, Array]:
    """Return times tau (T,), depths h (N,) and the error of Eq. (35) relative to Eq. (3), (T, N).

    The norm of `theories.behind_front`; NaN ahead of the light cone.
    """
    scene = column(WEAK, tau, int(continuum.depth(1.2 * tau)) + 30)
    scene = Scene(**scene.given() | {"samples": samples})
    times = scene.time / scene.chain.time_scale
    h = real(np.arange(scene.chain.grains) + 0.5)
    exact = theory(scene, "chebyshev").displacement / _unit(scene) / scene.chain.time_scale
    inside = continuum.chi(h) < times[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (
            times,
            h,
            np.where(
                inside, abs(continuum.impulse_response(h, times[:, None]) / exact - 1), np.nan
            ),
        )


def driven(frequency: float, tau: float = 150.0) -> tuple[Array, Complex]:
    """Return depths (G,) and complex amplitudes relative to grain 1, (G,).

    It is the factor of exp(i omega tau). The top is driven weakly at the frequency omega, in units
    of tau, for a time tau. The average is over the last four periods; left out are depths that the
    wave has reached but lately and, within 15 / omega of travel time, where no local wavelength is
    known.
    """
    chain = Chain(grains=int(continuum.depth(tau)), diameter=BEAD)
    drive = Drive(
        amplitude=WEAK * chain.length_scale, frequency=frequency / (2 * np.pi * chain.time_scale)
    )
    answer = theory(column(drive, tau, chain.grains), "chebyshev")
    times = answer.time / chain.time_scale
    window = np.clip((times - tau) * frequency / (2 * np.pi * PERIODS) + 1, 0, 1)
    motion = (np.sin(np.pi * window) ** 2 * np.exp(-1j * frequency * times)) @ answer.displacement
    settled = slice(*(int(continuum.depth(limit)) for limit in (15 / frequency, tau / 2.5)))
    return answer.grains[settled] - 0.5, motion[settled] / motion[0]


def phase_velocities(frequency: float, tau: float = 150.0) -> tuple[Array, Array]:
    """Return wavelengths in grains and relative phase velocities, (G,) each; see `driven`."""
    h, motion = driven(frequency, tau)
    number = -np.diff(np.angle(motion)) % (2 * np.pi)
    return 2 * np.pi / number, frequency / (h[:-1] + 0.5) ** (1 / 6) / number


def harmonic_error(frequency: float, tau: float = 150.0) -> tuple[Array, Array]:
    """Return depths and the error of `theories.harmonic_law` for a driven top, (G,) each."""
    h, motion = driven(frequency, tau)
    mode = continuum.mode(np.append(0.5, h), frequency).conj()  # The paper's wave comes from below.
    return h, np.abs(mode[1:] / mode[0] / motion - 1)


def fronts(tau: float) -> tuple[Array, Array, Array]:
    """Return grains, arrival times of the largest velocity, and half-height widths in tau, (G,)."""
    scene = column(WEAK, tau, int(continuum.depth(1.2 * tau)) + 30)
    front = track(theory(scene, "chebyshev"))
    return front.grain, front.time / scene.chain.time_scale, front.width / scene.chain.time_scale


def theory(scene: Scene, engine: str) -> Trajectory:
    """Return the solution of a theory, whatever its model error is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return simulate(scene, engine, 0.999)


def _at_its_end(scene: Scene) -> Scene:
    """Return the scene recorded at its end only."""
    return Scene(**scene.given() | {"samples": 2})


def _unit(scene: Scene) -> float:
    """Return the velocity of a weak strike, m/s."""
    return WEAK * scene.chain.length_scale / scene.chain.time_scale


def _distance(x: Array, reference: Array) -> float:
    return float(np.linalg.norm(x - reference) / np.linalg.norm(reference))


def _largest(x: Array, reference: Array) -> float:
    return float(np.abs(x - reference).max() / np.abs(reference).max())
