"""Memory layout of chains, and the tuples of arrays that the compiled loops exchange.

A row of bodies is a wall (or nothing), N grains and a wall (or nothing), grain 1 at the index
`PAD`, where a cache line begins; behind them come bodies that do not exist, up to a whole number of
lines. Whatever is held has no inverse mass.
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
    part, parts : int
        Which one, of how many.
    gate : (2 PAD,) array
        How many times one has come to wait and, at GIVEN_UP, whether one has given up.
    nearness : (parts, PAD) array
        In the first column, what each has found of the nearest opening of a contact.
    edges : (parts, EDGES) array
        Where the first grain of each was in every row of a sweep, m.
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

    They take tuples of arrays and numbers alone, so that these stand apart from `ChainBatch`.

    Attributes
    ----------
    inverse_length, strength : (R, W) arrays
        1 / length and strength of the contact below each body, see `contact_forces`.
    inverse_mass : (R, W) array
        1/kg, of each body; 0 of what is held.
    opening_length, opening_weight, opening_reach : (R, K, W) arrays
        K kinks of the contact below each body: 1 / distance of the overlap at rest from the kink,
        negative if closing leads to the kink; the square of the acceleration that the contact
        gives as it passes the kink, over what changes the motion; and how near to that time no
        step is shorter. A contact of powers has one kink, its opening.
    opening_rest : float
        Distance from kinks at rest in this length: 0 if contacts only touch, else 1.
    ground_kinks : (R, 2, J, W) array
        J kinks of the force from the ground on each body: the same length and weight.
    uncompressed : (R,) array
        N/m^delta: the constant of a first contact that touches without pressing in a compressed
        chain, else 0.
    least_strain : (R,) array
        The smallest r / length of any contact at rest: -1 if a contact is open or only touches.
    form : (R,) array
        Form of the force.
    loops : (R, 3 or 4) array
        Where the loops of the form lie in memory, see `contact_forces.addresses`.
    precompressed, coefficients : number and (8,) array
        See `contact_forces`.
    parameters : (R, P, W) array
        Overlap at rest, m, constant, parameters, and what else the force reads, of the contact
        below each body, for a law given by a formula; (R, 0, W) for powers.
    ground : int or None
        Where the loop of the force from the ground lies in memory; None without a ground, for which
        the marches are compiled without one.
    ground_parameters : (R, G, W) array
        Parameters of the force from the ground on each body.
    omega : (R,) array
        Highest frequency, rad/s.
    scale : (R, 2) array
        Largest displacement and speed of the excitation, m and m/s.
    units : (R, 2) array
        Overlap of the contact below grain 1 (that above it if there is none below), and the speed
        of that in the unit of time, m and m/s; no speed in the sonic vacuum.
    allowed : (R,) array
        What twice the kinetic energy cannot exceed, J: contacts never hold less energy than at
        rest.
    acts : bool
        Whether a motion or a force is imposed after t = 0.
    reach : (R, 2) array
        First and last body that it acts on; if none, the last before the first.
    wave : (R,) array of WAVE
    knots, pieces : (R, P) and (R, 4, P-1) arrays
        Times, s, and coefficients of a spline.
    laws : (2,) array
        Where the functions that know them lie in memory, see `waveform.addresses`.
    damped : bool
        Whether anything takes energy; `chain.damping` has the law and its symbols.
    alike : bool
        Whether it is contacts of one A a chain alone, and nothing pushes grains: then their creep
        is A times their acceleration.
    viscosity, drag, mass : (R, W) arrays
        A of the contact below each body, s; gamma, 1/s, and mass, kg, of each body that moves
        freely, 0 of others. (R, 0) arrays if nothing takes energy.
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
    x, v : (F R, W) arrays
        Displacements from equilibrium and velocities, m and m/s.
    history : (F R, H, W) array
        What the method keeps of earlier steps.
    state : (F R,) array of STATE
    team : Team
        Which threads share each chain.
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
        Of all contacts of the chain, so that numbers of one kind lie side by side.
    first : int
        Column of the first contact in them.
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
    kick, drift : (Q,) arrays
        Times by which accelerations and velocities are multiplied, s.
    carried : (Q,) array
        N: force on the first grain from above; then that on the last one from below.
    path : (Q,) array, or an empty one if nothing is imposed
        What is imposed: a displacement, m, or a force, N.
    time : (Q,) array
        Time of the kick, s; read by a force from the ground alone.
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
        h' / h of the shortened steps.
    close : float
        shortened^(-14/3), with which contacts that shorten no step are passed over.
    nearest : (F, R) array
        The largest nearness of an opening that shortens a step: that of the step that crosses it,
        for shorter ones gain nothing.
    """

    shortened: float
    close: float
    nearest: Array


class Noted(NamedTuple):
    """Record of Q steps of a chain in a march by steps.

    Attributes
    ----------
    ends : (Q,) array
        When each ends, s since the last sample, 0 on a sample.
    every : int
        Steps from one checkpoint to the next; the first step begins with one.
    states : (Q / every, 2, W) array
        Displacements and velocities there, reduced ones of a damped chain between samples.
    windows : (Q / every, 2) array
        First body of the window there, and the one behind its last.
    """

    ends: Array
    every: int
    states: Array
    windows: NDArray[np.int64]


class Fields(NamedTuple):
    """Output arrays of displacements and velocities, from the sample number `first` on.

    (R, B, N) arrays for the first schedule, (F - 1, R, B, N) for the others; zeros if N is larger
    than `WHOLE_ROWS`. `balance` takes what was lost and the work at all T samples, see `STATE`:
    (F, R, T, 2) J, or (F, R, 0, 2) if it is not asked for.
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
