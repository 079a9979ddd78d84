"""How chains lie in memory, and the tuples of arrays that the compiled loops hand on.

A row of bodies is a wall (or nothing), N grains and a wall (or nothing), grain 1 at the index `PAD`, where a cache line
begins; behind them come bodies that do not exist, up to a whole number of lines. Whatever is held has no inverse mass.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array

PAD = 8  # doubles in a cache line

RESOLUTION = 1e-9  # of a step: nearer to its ends what is imposed has no corner

# of what is imposed: amplitude (m or N), frequency and that of the envelope (rad/s) and end (s) of a sine; number of
# knots, 0 for a sine; the body that is driven, or less than 0 the one that is pushed
AMPLITUDE, OMEGA, ENVELOPE, END, KNOTS, BODY = range(6)

# State of a chain between two calls, from which a run goes on with the same bits:
STATE = np.dtype(
    [
        ("sample", "i8"),  # last sample on which a step has landed
        ("done", "f8"),  # since then: steps if all have one length, else s
        ("pending", "f8"),  # s: the part of a kick that is still due
        ("first", "i8"),  # first body of the active window,
        ("last", "i8"),  # and the one behind its last body
        ("least_strain", "f8"),  # smallest r / length of any contact; -1 is an opening
        ("largest_approach", "f8"),  # m, of two grains beyond that at rest
        ("largest_displacement", "f8"),  # m, of any grain
        ("largest_speed", "f8"),  # m/s, of any grain
        ("next_look", "i8"),  # steps after which these two are looked for again
        ("steps", "i8"),  # steps made since t = 0
        ("step_size", "f8"),  # s: of a method that changes it, or scales its history with it
        ("step_begin", "f8"),  # s after the last sample: where the last adaptive step began
    ],
    align=True,  # compiled loops read aligned numbers faster
)

# where threads that share a chain wait for each other, and what they tell each other: in a `gate`, how many times one
# has come to wait, and on a cache line of its own whether one has given up; in its row of a `board` each the nearest
# opening of a contact, and where its first grain was in every row of a `sweep`, fewer than EDGES
GIVEN_UP, NEARNESS, EDGE, EDGES = PAD, 0, PAD, 128
LEAST_SHARE = (
    4096  # grains of a thread; of this many, what it waits for others is a tenth of the time
)
WHOLE_ROWS = 512  # grains, a page: of no more, samples are written whole; of more, only as far as the wave has come


class Team(NamedTuple):
    """Which of how many threads one is that share a chain, and where they wait and tell each other."""

    part: int
    parts: int
    gate: NDArray[np.int64]
    board: Array


def team(parts: int) -> list[Team]:
    """Return what each of so many threads knows of the others."""
    gate, board = np.zeros(2 * PAD, dtype=np.int64), np.zeros((parts, EDGE + EDGES))
    return [Team(part, parts, gate, board) for part in range(parts)]


ALONE = team(1)[0]


class Chains(NamedTuple):
    """A batch of R chains in rows of W bodies, once for each of F schedules, one batch after the other.

    Attributes
    ----------
    x, v : (F R, W) arrays
        Displacements from equilibrium and velocities, m and m/s.
    history : (F R, H, W) array
        What the method keeps of earlier steps.
    state : (F R,) array of STATE
    table : (R, 3, W) array
        1 / length and strength of the contact below each body, and its inverse mass.
    uncompressed : (R,) array
        N/m^delta: the constant of a first contact that touches without pressing in a compressed chain, else 0.
    scale : (R, 2) array
        Largest displacement and speed of the excitation, m and m/s.
    omega : (R,) array
        Highest frequency, rad/s.
    forms, precompressed, coefficients : (R,) array, number and (8,) array
        See `contact_forces`.
    imposed : bool
        Whether the excitation acts after t = 0,
    acted : (R, 2) array
        on the bodies from the first to the last of these; else none, the last before the first.
    drive, knots, pieces : (R, 6), (R, P) and (R, 4, P-1) arrays
        How: see AMPLITUDE ... BODY; times and coefficients of a spline.
    team : Team
        Which threads share each chain.
    """

    x: Array
    v: Array
    history: Array
    state: Any
    table: Array
    uncompressed: Array
    scale: Array
    omega: Array
    forms: Array
    precompressed: float
    coefficients: Array
    imposed: bool
    acted: Array
    drive: Array
    knots: Array
    pieces: Array
    team: Team


class Chain(NamedTuple):
    """One chain of a batch, its number in it, and that of its schedule."""

    x: Array
    v: Array
    history: Array
    state: Any
    inverse_length: Array
    strength: Array
    inverse_mass: Array
    uncompressed: float
    scale: Array
    omega: float
    form: int
    precompressed: float
    coefficients: Array
    imposed: bool
    acted: Array
    drive: Array
    knots: Array
    pieces: Array
    team: Team
    number: int
    schedule: int


class Clock(NamedTuple):
    """Sample interval (s), last sample, steps and longest step (s) to a landing, samples between.

    `looks` says whether the largest motion is looked for, `dense` which samples between are interpolated: every so
    manieth, none if it is 0.
    """

    interval: float
    final: int
    steps: int
    step: float
    stride: int
    looks: bool
    dense: int


class Clocks(NamedTuple):
    """Sample interval (s), last sample, and of each of F schedules the other five of a `Clock`, (F, 5)."""

    interval: float
    final: int
    others: Array


class Fields(NamedTuple):
    """Where samples go, from the one with the number `first` on: displacements and velocities.

    (R, B, N) arrays for the first schedule, (F - 1, R, B, N) for the others; zeros if N is larger than `WHOLE_ROWS`.
    """

    u: Array
    v: Array
    others_u: Array
    others_v: Array
    first: int


class Row(NamedTuple):
    """The same of one chain: (B, N) arrays."""

    u: Array
    v: Array
    first: int


class Span(NamedTuple):
    """From one landing to the next: begin, end and length in s, and its steps if all are equal."""

    begin: float
    end: float
    length: float
    steps: int
    step: float
