"""Memory layout of chains, and the tuples of arrays that the compiled loops exchange.

A row of W bodies has a wall or an empty place, N grains, and a wall or an empty place. Grain 1 has
the index `PAD`, where a cache line begins. Empty places before and after fill the row to a whole
number of cache lines. The inverse mass of a body that is held or driven is 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array

PAD = 8  # Number of doubles in a cache line.

# A kink of the forcing within this fraction of a step from its end counts as at the end.
RESOLUTION = 1e-9

# Imposed on a chain after t = 0: a sine, possibly with an envelope, or a cubic spline.
WAVE = np.dtype(
    [
        ("amplitude", "f8"),  # Amplitude of a displacement, m, or of a force, N.
        ("omega", "f8"),  # Frequency, rad/s.
        ("envelope", "f8"),  # Frequency of the squared sine that multiplies the wave, rad/s.
        ("end", "f8"),  # End of the forcing, s.
        ("knots", "i8"),  # Number of knots of a spline; 0 for a sine.
        ("body", "i8"),  # Index of the driven body; negative for a pushed body.
    ],
    align=True,
)

# State of a chain between two calls, from which a run continues bit for bit.
STATE = np.dtype(
    [
        ("sample", "i8"),  # Last sample on which a step has landed.
        ("done", "f8"),  # Steps since that sample if all steps are equal, otherwise time, s.
        ("pending", "f8"),  # Remaining part of a kick, s.
        ("first", "i8"),  # First body of the active window.
        ("last", "i8"),  # Body after the last body of the window.
        ("least_strain", "f8"),  # Smallest r / length of any contact; -1 is an opening.
        ("largest_approach", "f8"),  # Largest approach of two grains from rest, m.
        ("largest_displacement", "f8"),  # Largest displacement of any grain, m.
        ("largest_speed", "f8"),  # Largest speed of any grain, m/s.
        ("next_look", "i8"),  # Number of steps at which these two are updated next.
        ("steps", "i8"),  # Number of steps since t = 0.
        ("step_size", "f8"),  # Length of the last step, s, with which Gear scales its history.
        ("step_begin", "f8"),  # Start of the last adaptive step, s after the last sample.
        ("lost", "f8"),  # Energy dissipated by viscous contacts and drag since t = 0, J.
        ("work", "f8"),  # Work of the force or on the driven body since t = 0, J.
        ("loss_rate", "f8"),  # Rates of both energies, W, which equal steps sum up.
        ("work_rate", "f8"),
    ],
    # Compiled loops read aligned numbers faster.
    align=True,
)

EDGES = 128  # Upper bound on the number of rows in a `sweep`.
# Index in a gate, on a separate cache line.
GIVEN_UP = PAD
# Smallest number of grains per thread; for it, waiting for other threads takes a tenth of the time.
LEAST_SHARE = 4096
# Up to this number of grains (one page), samples are written whole; beyond, only as far as the
# wave.
WHOLE_ROWS = 512


class Team(NamedTuple):
    """One of the threads that share a chain, with their shared memory.

    Attributes
    ----------
    part : int
        Number of this thread, from 0.
    parts : int
        Number of threads.
    gate : (2 PAD,) array
        Number of times that a thread has arrived at a point of synchronisation; at the index
        GIVEN_UP, 1 if a thread has failed.
    nearness : (parts, PAD) array
        In the first column, the nearness to an opening that each thread has computed.
    edges : (parts, EDGES) array
        Displacement of the first grain of each thread in every row of a sweep, m.
    """

    part: int
    parts: int
    gate: NDArray[np.int64]
    nearness: Array
    edges: Array


def team(parts: int) -> list[Team]:
    """Return the threads that share a chain."""
    gate = np.zeros(2 * PAD, dtype=np.int64)
    shared = gate, np.zeros((parts, PAD)), np.zeros((parts, EDGES))
    return [Team(part, parts, *shared) for part in range(parts)]


ALONE = team(1)[0]


class BatchArrays(NamedTuple):
    """Arrays of a batch of R chains that the compiled loops read, in rows of W bodies.

    This tuple is separate from `ChainBatch`, because compiled loops accept only tuples of arrays
    and numbers.

    Attributes
    ----------
    inverse_length : (R, W) array
        1 / length of the contact below each body, 1/m, see `contact_forces`.
    strength : (R, W) array
        Strength of the contact below each body, see `contact_forces`.
    inverse_mass : (R, W) array
        Inverse mass of each body, 1/kg; 0 for a body that is held or driven.
    opening_length : (R, K, W) array
        1 / distance of the overlap at rest from each of the K kinks of the force of the contact
        below each body, 1/m; negative if the contact reaches the kink by closing. A power law has
        one kink, the opening of the contact.
    opening_weight : (R, K, W) array
        Squared effect on the motion of passing each kink, see `openings`.
    opening_reach : (R, K, W) array
        Number from which `openings` decides whether a contact is too far from a kink to shorten a
        step.
    opening_rest : float
        Distance from a kink at rest, in units of the length: 0 if contacts touch without a force,
        else 1.
    ground_kinks : (R, 2, J, W) array
        Inverse length and weight, as above, of each of the J kinks of the force from the ground on
        each body.
    uncompressed : (R,) array
        Constant of a top wall that touches grain 1 without a force in a compressed chain,
        N/m^delta; else 0.
    least_strain : (R,) array
        Smallest r / length of any contact at rest: -1 if a contact is open or touches without a
        force, else 0.
    form : (R,) array
        Form of the force, see `contact_forces`.
    loops : (R, 3 or 4) array
        Memory addresses of the loops of the form, see `contact_forces.addresses`.
    precompressed : float
        1 in a compressed chain, 0 in a chain without compression.
    coefficients : (8,) array
        Binomial coefficients and delta, see `contact_forces`.
    parameters : (R, P, W) array
        For a law that is given by a formula: overlap at rest, m, constant, parameters, and other
        numbers that the force of the contact below each body requires. (R, 0, W) for power laws.
    ground : int or None
        Memory address of the loop for the force from the ground. If it is None, there is no ground,
        and the marches are compiled without one.
    ground_parameters : (R, G, W) array
        Parameters of the force from the ground on each body.
    omega : (R,) array
        Highest frequency, rad/s.
    scale : (R, 2) array
        Largest displacement, m, and largest speed, m/s, of the excitation.
    units : (R, 2) array
        Length of the first compressed contact below grain 1, m, or of the contact above grain 1 if
        there is none below. The length of a power law is the overlap at rest. The second number is
        this length times the frequency sqrt(stiffness / mass) of the contact with the mass of
        grain 1, m/s. Both are 0 in a sonic vacuum.
    allowed : (R,) array
        Upper bound on twice the kinetic energy, J. The bound exists because contacts never store
        less energy than at rest.
    acts : bool
        Whether a motion or a force is imposed after t = 0.
    reach : (R, 2) array
        First and last body on which the forcing acts; the last one precedes the first one if there
        is none.
    wave : (R,) array of WAVE
        Imposed motion or force.
    knots : (R, P) array
        Times of the knots of a spline, s.
    pieces : (R, 4, P-1) array
        Coefficients of the pieces of the spline.
    laws : (2,) array
        Memory addresses of the functions that evaluate the forcing, see `waveform.addresses`.
    damped : bool
        Whether the chain dissipates energy; `chain.damping` defines the law and its symbols.
    alike : bool
        Whether the creep is A times the acceleration. This is so if all contacts have the same A
        and there is no drag, no external force and no ground.
    viscosity : (R, W) array
        Viscosity A of the contact below each body, s; (R, 0) without damping.
    drag : (R, W) array
        Drag gamma of each body, 1/s; 0 for a body that is held or driven; (R, 0) without damping.
    mass : (R, W) array
        Mass of each body, kg; 0 for a body that is held or driven; (R, 0) without damping.
    """

    inverse_length: Array
    strength: Array
    inverse_mass: Array
    opening_length: Array
    opening_weight: Array
    opening_reach: Array
    opening_rest: float
    ground_kinks: Array
    uncompressed: Array
    least_strain: Array
    form: NDArray[np.int64]
    loops: NDArray[np.int64]
    precompressed: float
    coefficients: Array
    parameters: Array
    ground: int | None
    ground_parameters: Array
    omega: Array
    scale: Array
    units: Array
    allowed: Array
    acts: bool
    reach: NDArray[np.int64]
    wave: NDArray[Any]
    knots: Array
    pieces: Array
    laws: NDArray[np.int64]
    damped: bool
    alike: bool
    viscosity: Array
    drag: Array
    mass: Array


class Chains(NamedTuple):
    """A batch of R moving chains, repeated for each of F schedules.

    Attributes
    ----------
    batch : BatchArrays
        Constant arrays of the R chains.
    x : (F R, W) array
        Displacements from equilibrium, m.
    v : (F R, W) array
        Velocities, m/s.
    history : (F R, H, W) array
        Values of earlier steps that the method stores.
    state : (F R,) array of STATE
        Progress, window and largest values of each chain.
    team : Team
        This thread, among the threads that share each chain.
    """

    batch: BatchArrays
    x: Array
    v: Array
    history: Array
    state: NDArray[Any]
    team: Team


class Links(NamedTuple):
    """The contacts of one chain, or a part of them; fields as in `BatchArrays`.

    Attributes
    ----------
    parameters : (P, W) array
        Parameters of all contacts of the chain, even if the other arrays contain a part of them.
    first : int
        Column of the first contact of the part in `parameters`.
    """

    inverse_length: Array
    strength: Array
    uncompressed: float
    form: int
    loops: NDArray[np.int64]
    precompressed: float
    coefficients: Array
    parameters: Array
    first: int


class Imposed(NamedTuple):
    """A motion or force imposed on one chain after t = 0; fields as in `BatchArrays`."""

    acts: bool
    reach: NDArray[np.int64]
    wave: Any
    knots: Array
    pieces: Array
    laws: NDArray[np.int64]


class BatchMember(NamedTuple):
    """One chain of `Chains` with its indices in the batch and among the schedules."""

    x: Array
    v: Array
    history: Array
    state: Any
    inverse_mass: Array
    links: Links
    ground: int | None
    ground_parameters: Array
    opening_length: Array
    opening_weight: Array
    opening_reach: Array
    opening_rest: float
    ground_kinks: Array
    imposed: Imposed
    scale: Array
    omega: float
    damped: bool
    alike: bool
    viscosity: Array
    drag: Array
    mass: Array
    team: Team
    number: int
    schedule: int


class Rows(NamedTuple):
    """Rows of a sweep, (Q,) arrays; in each row, all grains are kicked and then drift.

    Attributes
    ----------
    kick : (Q,) array
        Time by which a kick multiplies accelerations, s.
    drift : (Q,) array
        Time by which a drift multiplies velocities, s.
    carried : (Q,) array
        Force from above on the first grain, N, which a sweep replaces by the force from below on
        the last grain.
    path : (Q,) array, or an empty array if nothing is imposed
        Imposed displacement, m, or force, N.
    time : (Q,) array
        Time of the kick, s, at which the force from the ground is evaluated.
    """

    kick: Array
    drift: Array
    carried: Array
    path: Array
    time: Array


def make_rows(count: int, acts: bool) -> Rows:
    """Return this number of rows, including whether a forcing is imposed."""
    kick, drift, carried, path, time = np.zeros((5, count))
    return Rows(kick, drift, carried, path[: count if acts else 0], time)


class SplittingStages(NamedTuple):
    """Kicks (S+1,) and drifts (S,) of a splitting, and their sums (S,), as fractions of a step."""

    kicks: Array
    drifts: Array
    reach: Array


class Shortening(NamedTuple):
    """Shortening of steps around contact openings, for F schedules and R chains.

    Attributes
    ----------
    shortened : float
        Ratio h' / h of a shortened step at the time 1 / omega from an opening.
    close : float
        Number shortened^(-14/3), from which `openings` decides whether any contact shortens a step.
    nearest : (F, R) array
        Upper bound on the nearness of an opening, as in `openings`. It limits the length of the
        step that crosses the opening, because still shorter steps would gain nothing.
    """

    shortened: float
    close: float
    nearest: Array


class Noted(NamedTuple):
    """Record of Q steps of a chain in a march by steps.

    Attributes
    ----------
    ends : (Q,) array
        End of each step, s since the last sample; 0 if the step ends on a sample.
    every : int
        Number of steps from one checkpoint to the next. The first checkpoint is at the start of the
        first step.
    states : (Q / every, 2, W) array
        Displacements, m, and velocities, m/s, at the checkpoints. Between samples the velocities of
        a damped chain are reduced velocities.
    windows : (Q / every, 2) array
        First body of the window, and the body after its last one, at the checkpoints.
    """

    ends: Array
    every: int
    states: Array
    windows: NDArray[np.int64]


class Fields(NamedTuple):
    """Output arrays of displacements and velocities, from the sample number `first` on.

    If N is larger than `WHOLE_ROWS`, the arrays of motions must contain zeros, because grains that
    the wave has not reached are not written.

    Attributes
    ----------
    u : (R, B, N) array
        Displacements of the main run, m.
    v : (R, B, N) array
        Velocities of the main run, m/s.
    others_u : (F - 1, R, B, N) array
        Displacements of the runs by the other schedules, m.
    others_v : (F - 1, R, B, N) array
        Velocities of the runs by the other schedules, m/s.
    first : int
        Number of the first sample in these arrays.
    balance : (F, R, T, 2) array
        Dissipated energy and work of the forcing at all T samples, J, see `STATE`; (F, R, 0, 2) if
        they are not requested.
    """

    u: Array
    v: Array
    others_u: Array
    others_v: Array
    first: int
    balance: Array


class SampleRow(NamedTuple):
    """Output arrays (B, N) of one chain, from the sample number `first` on; see `Fields`."""

    u: Array
    v: Array
    first: int
    balance: Array
