"""Search for periodic orbits near a guess, a linear mode, a driven response or a branch point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import svd

from ..chain.chain import Chain
from ..errors import InputError, RunFailed, shown
from ..scene.excitation import Drive, Force, Profile
from ..theory.modes import eigenmodes
from ..theory.steady import displacements
from ..util.arrays import Array
from ..util.validation import Checked, check_positive
from .continuation import family_curve, follow
from .damped_flow import flow_of
from .family import Event
from .floquet import in_one_thread
from .flow import Flow, check_sine
from .orbit import Orbit, orbit_of
from .shooting import Equations, OrbitPoint, estimate_error, fixed, plane, solve_accurately

Guess = Profile | tuple[Array, Array] | None
WEAK = 1e-2  # Ratio of drives; the response to a drive weakened by this factor is nearly linear.
REST = 1e-3  # Ratio to the guess; a smaller orbit is the chain at rest.


@in_one_thread
def find(
    chain: Chain,
    guess: Orbit | Guess = None,
    period: float | None = None,
    *,
    energy: float | None = None,
    drive: Drive | Force | None = None,
) -> Orbit:
    """Return the periodic orbit near a guess by Newton shooting with the exact tangent map.

    A guess with all grains at rest gives an orbit that is symmetric in time, at half the cost. The
    motion is integrated by a splitting of order 8, or by a Runge-Kutta method if there is damping
    or a force. The number of steps in a period is determined by their error; steps are shorter
    where contacts open. See J. L. Marin and S. Aubry, Nonlinearity 9, 1501 (1996), for breathers by
    Newton's method.

    Parameters
    ----------
    chain : Chain
    guess : Profile, Orbit, or (displacement, velocity), each (N,)
        State at t = 0, m and m/s. If None, the search starts from the linear response to the drive,
        or from the response to a weak drive that is raised step by step.
    period : float
        Period, s; for a driven orbit a whole number of periods of the drive, by default one. If an
        energy is given, the period is only a guess.
    energy : float, optional
        Energy above rest, J, which determines the period.
    drive : Drive or Force, optional
        Harmonic motion of grain 1 or of the top wall, or harmonic force on a grain. Its `start` is
        the default guess. A damped chain requires a drive.

    Returns
    -------
    Orbit

    Raises
    ------
    InputError
        If the guess, period, energy or drive is not valid, or the chain flies apart.
    RunFailed
        If Newton's method finds no orbit, or only the chain at rest.

    Examples
    --------
    >>> chain = Chain(grains=2, diameter=1e-3)  # one grain that moves, under its weight
    >>> guess = [0.5 * chain.length_scale, 0.0], [0.0, 0.0]
    >>> orbit = find(chain, guess, period=1.02 * 2 * np.pi * chain.time_scale)
    >>> orbit.residual < 1e-12, orbit.stable, f"{orbit.displacement[0] / chain.length_scale:.3f}"
    (True, True, '0.613')
    """
    if isinstance(guess, Orbit):
        period = period or guess.period
        guess = (guess.displacement, guess.velocity)
    if drive is not None:
        check_sine(drive)
        guess, drive = _take_start(guess, drive)
    if energy is not None:
        if drive is not None:
            raise InputError.at("energy", "is not conserved in a driven chain: give the period")
        energy = check_positive("energy", energy)
    flow, period = _flow(chain, period, drive)
    state = flow.canonical(*(_linear_answer(flow) if guess is None else _state(chain, guess)))
    size = float(np.abs(state).max())
    if not size > 0:
        raise InputError.at("guess", "is the chain at rest: give displacements or velocities")
    # Relative momenta of the size of rounding errors count as 0.
    reversible = drive is None and bool(np.abs(state[1]).max() < 1e-12 * size)
    equations = Equations(lambda _: flow, reversible, size)
    key, value = ("period", period) if energy is None else ("energy", energy)
    target = fixed(equations, key, value)
    name = f"a period of {period:g} s"
    try:
        solution, error = solve_accurately(equations, OrbitPoint(state, period), [target], name)
    except RunFailed:
        if guess is not None or drive is None:
            raise
        return find(chain, _raise_drive(chain, drive, period), period, drive=drive)
    if np.abs(solution.point.state).max() < REST * size and drive is None:
        raise RunFailed(
            "only the chain at rest is found near the guess: make it larger, or change the period"
        )
    return orbit_of(equations, solution, error)


def _take_start(guess: Guess, drive: Drive | Force) -> tuple[Guess, Drive | Force]:
    """Return the start of the search, by default the start of a drive, and the drive without it."""
    if drive.start is not None:
        return drive.start if guess is None else guess, drive.replace(start=None)
    return guess, drive


def _raise_drive(chain: Chain, drive: Drive | Force, period: float) -> Orbit:
    """Return the response to a drive of full strength, continued from weaker drives."""
    weak = drive.replace(amplitude=WEAK * drive.amplitude)
    guess = _linear_answer(_flow(chain, period, weak)[0])
    first = find(chain, guess, period, drive=weak)
    family = follow(first, "drive.amplitude", drive.amplitude, events=False)
    if not family.reached:
        raise RunFailed(f"no periodic orbit found from a weaker drive: {family.ended}")
    return family[-1]


def _flow(chain: Chain, period: float | None, drive: Drive | Force | None) -> tuple[Flow, float]:
    """Return the flow over a period, and the period, by default the period of the drive."""
    frequency = None if drive is None else drive.frequency
    if period is None and frequency is not None:
        period = 1 / frequency
    period = check_positive("period", period)
    turns = 1.0 if frequency is None else frequency * period
    if round(turns) < 1 or abs(turns - round(turns)) > 1e-9 * turns:
        raise InputError.at(
            "period", f"must be a whole number of periods of the drive, {period / turns:g} s"
        )
    return flow_of(chain, 2 * np.pi / period, drive, round(turns)), period


def linear_mode(chain: Chain, mode: int, strain: float = 1e-3) -> tuple[Array, float]:
    """Return the displacement (N,) and the period (s) of a small linear mode.

    Parameters
    ----------
    chain : Chain
    mode : int
        Number of the mode, from 1 in the order of frequencies.
    strain : float
        Largest change of an overlap relative to the overlap at rest; for a law by formula,
        relative to the change at which a wave is no longer weak.

    Returns
    -------
    (N,) array and float
        Displacement, m, and period, s.

    Raises
    ------
    InputError
        If no contact is compressed, or the mode does not exist.
    """
    chain.refuse_ground("the search for orbits")
    modes = eigenmodes(chain)
    check_number("mode", mode, modes.frequency.size)
    u = np.zeros(chain.grains)
    u[: chain.movable] = modes.shape[:, mode - 1]
    contacts = chain.contacts
    strains = np.abs(contacts.closer(u))[contacts.pressed] / contacts.length[contacts.pressed]
    return strain / strains.max() * u, float(2 * np.pi / modes.frequency[mode - 1])


def check_number(key: str, value: Any, last: int) -> None:
    """Raise `InputError` unless a number is an integer from 1 to `last`."""
    integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not integer or not 1 <= value <= last:
        message = f"must be a whole number from 1 to {last} (got {shown(value)})"
        raise InputError.at(key, message)


def _state(chain: Chain, guess: Profile | tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the checked displacement and velocity (N,) of a guess, m and m/s."""
    if not isinstance(guess, Checked):
        try:
            displacement, velocity = guess
        except (TypeError, ValueError):
            message = "must be a Profile, an Orbit, or displacements and velocities"
            raise InputError.at("guess", message) from None
        guess = Profile(displacement=displacement, velocity=velocity)
    if faults := list(guess.faults(chain, 1.0)):
        raise InputError([(f"guess.{key}", message) for key, message in faults])
    return guess.initial(chain)


def _linear_answer(flow: Flow) -> tuple[Array, Array]:
    """Return the linear response to the drive at t = 0, m and m/s."""
    chain = flow.chain
    drive = flow.drive
    if drive is None:
        message = "give displacements and velocities, such as those of a linear mode"
        raise InputError.at("guess", f"is missing: {message}")
    if not chain.linearisable:
        message = "a chain without compression has no linear response to a drive"
        raise InputError.at("guess", f"is missing, and {message}")
    omega = 2 * np.pi * drive.frequency
    # The motions are Im(u exp(i omega t)); a driven grain 1 moves as the drive.
    answer = displacements(chain, drive)[1:-1]
    answer[: flow.free.start] = 0.0
    return answer.imag, omega * answer.real


@dataclass(frozen=True)
class Branching:
    """Distance from a period doubling at which the first orbit of its branch is sought.

    Attributes
    ----------
    distances : tuple of float
        Distances relative to the size of the orbit, which are tried one after the other.
    still : float
        Largest change of a momentum, relative to the change of the state, for which all grains
        begin at rest.
    """

    distances: tuple[float, ...] = (0.02, 0.05, 0.005)
    still: float = 1e-6


BRANCHING = Branching()


@in_one_thread
def switch(event: Event) -> Orbit:
    """Return an orbit of twice the period on the branch that starts at a period doubling.

    The orbit is displaced a little from the orbit of the event along the Floquet direction of the
    multiplier -1, and the parameter of the family changes accordingly. Use `follow` to continue the
    branch from this orbit.

    Parameters
    ----------
    event : Event
        Period doubling of a family.

    Returns
    -------
    Orbit

    Raises
    ------
    InputError
        If the event is not a period doubling.
    RunFailed
        If no orbit of twice the period is found.
    """
    if not isinstance(event, Event) or event.kind != "period doubling":
        kind = event.kind if isinstance(event, Event) else event
        raise InputError.at("event", f'must be a "period doubling" of a family (got {shown(kind)})')
    single = event.orbit
    direction = svd(single.monodromy + np.eye(len(single.monodromy)))[2][-1]
    momenta = direction[single.flow.size :]
    twice = replace(
        single,
        period=2 * single.period,
        flow=replace(single.flow, cycles=2 * single.flow.cycles),
        # Either of two orbits half a period apart may begin with all grains at rest.
        reversible=single.reversible and bool(np.abs(momenta).max() < BRANCHING.still),
    )
    curve, first = family_curve(twice, event.parameter, event.value, event.value, event.hold)
    curve = replace(curve, exact=True)
    equations = curve.equations
    begin = equations.pack(first)
    row = np.zeros(begin.size)
    # The momenta, which are left out if all grains begin at rest, are negligible.
    inner = direction[: equations.period_at(begin)]
    row[: inner.size] = inner
    for share in BRANCHING.distances:
        ahead = begin + share * np.linalg.norm(begin[: inner.size]) * row
        beside = plane(ahead, row)
        solution = curve.solve(equations.unpack(ahead), beside)
        if solution is None:
            continue
        point = solution.point
        if _differs(equations.flow_at(point.value), single.mesh, point, share):
            error = estimate_error(equations, solution, [*curve.held, beside])
            return orbit_of(equations, solution, error)
    raise RunFailed(f"no orbit of twice the period was found near {event.value:g}")


def _differs(flow: Flow, mesh: Array, point: OrbitPoint, share: float) -> bool:
    """Return whether an orbit differs from itself half a period later by more than rounding."""
    half = replace(flow, cycles=max(flow.cycles // 2, 1))
    later = half.run(point.state, point.period / 2, mesh).end
    return bool(np.linalg.norm(later - point.state) > share * np.linalg.norm(point.state))
