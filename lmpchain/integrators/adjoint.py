"""Exact derivatives of a run by a kick-drift splitting: its discrete adjoint and its tangent.

The run is a chain of kicks and drifts, and the adjoint takes derivatives with respect to what was seen of it back
through them, one by one: the result is the derivative of the numbers that the run gives, to round-off, and so that of
the solution up to the error of the steps. A contact that opens or closes is no exception for delta > 1, where its force
and stiffness are continuous. For delta = 1 the stiffness jumps: what is returned is the derivative with every contact
open or closed where the run found it so, which is that of the run unless an evaluation falls on the very opening, and
converges to that of the solution with the step, at first order only.

The run itself is made by the loops of the native engine, and leaves a checkpoint now and then. Where all contacts are
pressed at rest, and delta is 3/2 or the wave so weak that a series does, the way back undoes each piece between two
checkpoints in the same pass in which it takes adjoints back. Else it makes the piece once more, and keeps of it one
number a contact and evaluation, within the cache: undone, round-off would open or close contacts that only touch.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly, poly2cheb
from numpy.typing import NDArray

from ..scene.acting import Drive, Force
from ..scene.scene import Scene
from ..util.arrays import Array
from .batch import ChainBatch
from .imposed import ImposedCourse
from .kernels import adjoint as kernels
from .kernels.adjoint_tangent import tangent
from .kernels.contact_forces import POLYNOMIAL, ROOTS
from .kernels.layout import ALONE, PAD, Chain
from .splittings import Splitting

ROOM = 2**19  # bytes for what is kept between two checkpoints, about what stays in the cache
LEAST = 32  # rows between two checkpoints
FEW = 256  # rows that are undone from a checkpoint: with 8 to 512 derivatives are the same to 7e-14
CHECKPOINTS = 2**29  # bytes of all checkpoints
PAGE = 512  # numbers; a load waits for a store to the same place of another page
STRIDE = 360  # from a row of the way back to the next, modulo that
UNSEEN = 2.0  # strain between two checkpoints over the largest at any
SHORT, LONG = 4, 6  # coefficients of `economised`
CALL = 2**16  # rows in a call of the compiled loops where something is imposed in each


class Inputs(NamedTuple):
    """What a motion depends on: derivatives by it, or directions (D, ...) in which it changes.

    Attributes
    ----------
    masses : (N,) array
        kg, with the forces at rest as they are.
    constants : (N+1,) array
        K_n of all contacts, those with walls included, with the forces at rest as they are.
    forces : (N+1,) array
        What every contact carries at rest, N; nothing where that is nothing.
    displacement, velocity : (N,) arrays
        Of every grain at t = 0, m and m/s.
    drive : (P,) array
        Amplitude and frequency of a drive or a force, or its samples.
    """

    masses: Array
    constants: Array
    forces: Array
    displacement: Array
    velocity: Array
    drive: Array

    def __add__(self, other: Any) -> Inputs:
        return Inputs(*(mine + its for mine, its in zip(self, other, strict=True)))


def aligned(rows: int, width: int) -> Array:
    """Return zeros (rows, width), where rows of whole cache lines begin with one."""
    memory = np.zeros(rows * width + PAD)
    skip = -memory.ctypes.data // memory.itemsize % PAD
    return memory[skip : skip + rows * width].reshape(rows, width)


def economised(exponent: float, reach: float) -> Array:
    """Return the coefficients of a polynomial for ((1 + s)^exponent - 1) / s, |s| <= reach, (4,) or (6,).

    The binomial series in Chebyshev polynomials. For delta = 3/2 four are right to every digit up to 3e-4, six up to
    0.007 and to 4e-15 at 0.0126.
    """
    k, reach = np.arange(12), min(max(reach, 1e-6), 0.02)
    parts = poly2cheb(np.cumprod((exponent - k) / (k + 1)) * reach**k)
    terms = SHORT if np.abs(parts[SHORT:]).sum() <= 1e-16 * abs(parts[0]) else LONG
    found = cheb2poly(parts[:terms])  # without zeros at its end
    return np.pad(found, (0, terms - found.size)) / reach ** np.arange(terms)


class DifferentiableRun:
    """A run by given steps with its exact derivatives.

    Parameters
    ----------
    scene : Scene
    method : Splitting
    step : float, or sequence of `looks` arrays
        s; the largest step up to it that divides the time between two looks is used. Or all steps between two looks.
    looks : int
        Equal parts of the duration, at whose ends grains are looked at.
    grains : (G,) array
        Numbers of the grains that are looked at.

    Attributes
    ----------
    time : (looks+1,) array
        When grains are looked at, s; from 0 to the duration.
    step : float
        The longest step taken, s.
    displacement, velocity : (looks+1, G) arrays
        m and m/s.
    """

    def __init__(
        self,
        scene: Scene,
        method: Splitting,
        step: float | list[Array],
        looks: int,
        grains: NDArray[np.intp],
    ):
        self.scene, self.grains = scene, np.asarray(grains)
        self.time = np.linspace(0.0, scene.duration, looks + 1)
        if isinstance(step, list):
            lengths, made = np.concatenate(step), [len(part) for part in step]
            begins = np.concatenate(
                [t + np.cumsum(part) - part for t, part in zip(self.time, step, strict=False)]
            )
        else:
            each = max(1, math.ceil(scene.duration / looks / step * (1 - 1e-12)))
            lengths, made = np.full(looks * each, scene.duration / (looks * each)), [each] * looks
            begins = np.arange(looks * each) * lengths[0]
        self.step, self.steps, self._begins = float(lengths.max()), lengths.size, begins
        begun = np.concatenate(([0], np.cumsum(made)))
        self._reach = np.array((0.0, *method.reach[:-1]))
        self._course = np.array(method.kicks), np.array(method.drifts), lengths, begun
        self._offsets = method.evaluations * begun + np.arange(looks + 1)  # rows before each look
        self.imposed = (
            ImposedCourse(scene.excitation)
            if isinstance(scene.excitation, (Drive, Force))
            else None
        )
        self._driven = scene.excitation.driven if self.imposed else 0
        self._read(scene)
        width, rows = self._table.shape[1], int(self._offsets[-1])
        most = FEW if self._law <= kernels.UNDONE_SHORT else max(LEAST, ROOM // (8 * width))
        most = max(most, math.ceil(rows * 16 * width / CHECKPOINTS))
        starts = np.append(np.arange(0, rows, most), rows)
        before = np.searchsorted(self._offsets, starts, side="right") - 1
        states = np.empty((starts.size, 2, width))
        states[0] = self._x[0], self._v[0]
        self._pieces = (
            starts,
            before,
            starts - self._offsets[before],
            states,
            np.empty((starts.size - 1, 2)),
        )
        self._most = min(most, rows)
        self._looks = np.zeros((2, looks + 1, self.grains.size))
        self._run()

    def _read(self, scene: Scene) -> None:
        """Lay out the chain for the compiled loops."""
        batch, chain = ChainBatch([scene]), scene.chain
        u, v = batch.initial
        self._x, self._v, state = batch.placed(u[None], v[None])
        self._window = state["first"][0], state["last"][0]  # where it begins and ends at t = 0
        arrays = batch.arrays(self._x, self._v, np.zeros((1, 0, self._x.shape[1])), state)
        length, strength, mobility = batch.table[0]
        x, v, history, self._state = (rows[0] for rows in arrays[:4])
        self._chain = Chain(
            x, v, history, self._state, length, strength, mobility, batch.uncompressed[0], batch.scale[0],
            batch.omega[0], batch.forms[0], batch.precompressed, batch.coefficients, batch.imposed, batch.acted[0],
            batch.drive[0], batch.knots[0], batch.pieces[0], ALONE, 0, 0,
        )  # fmt: skip
        self._table = aligned(3, self._x.shape[1])  # of the contact above each body
        self._table[:2, 1:] = batch.table[0, :2, :-1]
        self._table[2] = chain.exponent * self._table[1] * self._table[0]
        pressed = batch.precompressed > 0 and batch.uncompressed[0] == 0
        weakest, strong, hertz = (
            batch.forms[0] == POLYNOMIAL,
            batch.forms[0] in ROOTS,
            chain.exponent == 1.5,
        )
        if pressed and weakest:
            self._law = kernels.UNDONE_SERIES
        elif pressed and hertz:
            self._law = kernels.UNDONE_PLAIN if strong else kernels.UNDONE_EXACT
        elif hertz and not batch.precompressed:
            self._law = kernels.VACUUM
        else:
            self._law = (kernels.PLAIN if strong else kernels.HERTZ) if hertz else kernels.OTHER
        self._less = chain.exponent - 1.0
        self._room = np.zeros((5, 2 * kernels.BURST))

    def _times(self, row: int, count: int) -> Array:
        """Return the times of some rows, s."""
        rows = np.arange(row, row + count)
        look = np.searchsorted(self._offsets, rows, side="right") - 1
        step, stage = np.divmod(rows - self._offsets[look], len(self._reach))
        at = self._course[3][look] + step
        over = at == self._course[3][look + 1]  # the last kick before a look
        at = np.where(over, at - 1, at)
        return np.where(
            over, self.time[look + 1], self._begins[at] + self._reach[stage] * self._course[2][at]
        )

    def _path(self, row: int, count: int) -> Array:
        """Return what is imposed in some rows, or nothing."""
        return (
            np.empty(0)
            if self.imposed is None
            else self.imposed.waveform.at(self._times(row, count))
        )

    def _calls(self) -> list[tuple[NDArray[np.intp], int, int]]:
        """Return, for every call of a compiled loop, some pieces, the first row and how many there are."""
        starts = self._pieces[0]
        each = starts.size if self.imposed is None else max(1, CALL // self._most)
        cuts = np.append(np.arange(0, starts.size - 1, each), starts.size - 1)
        return [
            (np.array(some), int(starts[some[0]]), int(np.diff(starts[list(some)])[0]))
            for some in pairwise(cuts)
        ]

    def _run(self) -> None:
        """Move on to the end, with checkpoints at the begin of every piece."""
        columns = self.grains + (PAD - 1)
        self._looks[:, 0] = self._x[0, columns], self._v[0, columns]
        self._state["first"], self._state["last"] = self._window
        common = self._chain, self._course, self._room
        for some, row, count in self._calls():
            kernels.forward(
                *common, self._path(row, count), self._pieces, some, (columns, self._looks)
            )
        if self.imposed and self._driven:
            for order in (0, 1):
                self._looks[order][:, self.grains == 1] = self.imposed.waveform.at(
                    self.time, order
                )[:, None]

    @property
    def displacement(self) -> Array:
        """Displacement of the grains looked at, (looks+1, G) m."""
        return self._looks[0]

    @property
    def velocity(self) -> Array:
        """Velocity of the grains looked at, (looks+1, G) m/s."""
        return self._looks[1]

    def pull(self, displacement: Array, velocity: Array, everywhere: bool = True) -> Inputs:
        """Return the derivatives of an answer by all inputs, from those by what was seen.

        Parameters
        ----------
        displacement, velocity : (looks+1, G) arrays
            Derivatives of the answer with respect to each displacement, 1/m, and velocity, s/m, looked at.
        everywhere : bool
            Whether derivatives by displacement and velocity at t = 0 are wanted, also of grains that never move.
            Without them, the way back stays within the light cone of the run.
        """
        chain, grains = self.scene.chain, self.scene.chain.grains
        looks = np.array([displacement, velocity], dtype=float)
        by_course = np.zeros(self.imposed.size if self.imposed else 0)
        if self.imposed and self._driven:
            own = looks[..., self.grains == 1].sum(-1)
            by_course += self.imposed.pull(self.time, own[1], 1) + self.imposed.pull(
                self.time[:1], own[0, :1], 0
            )
            looks[1][:, self.grains == 1] = 0.0
        width, columns = self._x.shape[1], self.grains + (PAD - 1)
        adjoint, bodies, table = np.split(
            aligned(11, width + PAD + (STRIDE - width - PAD) % PAGE), (5, 8)
        )
        bodies[2, 1 : width + 1], table[:, :width] = self._chain.inverse_mass, self._table
        powers = aligned(1 if self._law <= kernels.UNDONE_SHORT else self._most, width)
        tops = np.empty((2, self._most))
        forces = aligned(self._most if self._law == kernels.OTHER else 1, width)
        state = self._state.copy()
        law, polynomial = self._law, self._chain.coefficients
        if law == kernels.UNDONE_SERIES:
            strain = float(
                max(-state["least_strain"], state["largest_approach"] * self._table[0].max())
            )
            polynomial = economised(self._less, min(UNSEEN * strain, self.scene.largest_strain))
            law = kernels.UNDONE_SHORT if polynomial.size == SHORT else law
        chain_back = self._chain._replace(state=state, coefficients=polynomial)
        common = law, self._less, chain_back, table, self._course, self._room
        kept = powers, forces, tops
        for some, row, count in reversed(self._calls()):
            path = self._path(row, count)
            on_path = np.zeros(path.size)
            kernels.backward(
                *common,
                path,
                self._pieces,
                some,
                kept,
                bodies,
                (columns, looks),
                adjoint,
                on_path,
                everywhere,
            )
            if self.imposed:
                by_course += self.imposed.pull(self._times(row, count), on_path, 0)
        contacts, (x, pull, _, _, by_mass) = chain.contacts, adjoint[:, PAD + 1 :][:, :grains]
        v = pull * chain.masses
        np.add.at(x, self.grains - 1, looks[0, 0])
        np.add.at(v, self.grains - 1, looks[1, 0])
        by_power, by_force = adjoint[2:4, PAD : PAD + grains + 1]
        stiffness = table[2, PAD : PAD + grains + 1]
        by_power = np.divide(by_power, stiffness, out=np.zeros(grains + 1), where=stiffness > 0)
        held = self._chain.inverse_mass[PAD : PAD + grains] == 0
        constant = np.where(contacts.exists, contacts.constant, 1.0)
        return Inputs(
            -by_mass / chain.masses, np.where(contacts.exists, by_force - contacts.force * by_power, 0.0) / constant,
            np.where(contacts.pressed, by_power, 0.0), np.where(held, 0.0, x), np.where(held, 0.0, v), by_course,
        )  # fmt: skip

    def push(self, change: Inputs) -> tuple[Array, Array]:
        """Return how displacement and velocity looked at change, (D, looks+1, G), in D directions."""
        chain, contacts, columns = (
            self.scene.chain,
            self.scene.chain.contacts,
            self.grains + (PAD - 1),
        )
        width, grains = self._x.shape[1], self.scene.chain.grains

        def bodies(rows: Array) -> Array:
            wide = np.zeros((len(rows), width))
            wide[:, PAD : PAD + rows.shape[1]] = rows
            return wide

        held = self._chain.inverse_mass[PAD : PAD + grains] == 0
        dx, dv = (
            bodies(np.where(held, 0.0, part)) for part in (change.displacement, change.velocity)
        )
        looks = np.zeros((len(dx), *self._looks.shape))
        looks[:, 0, 0], looks[:, 1, 0] = dx[:, columns], dv[:, columns]
        near = np.zeros((6, width))
        inverse = np.divide(1.0, contacts.constant, out=np.zeros(grains + 1), where=contacts.exists)
        near[4:, PAD : PAD + grains + 1] = inverse, contacts.force
        relative, forces = (
            change.masses / chain.masses,
            np.where(contacts.pressed, change.forces, 0.0),
        )
        fixed = bodies(relative), bodies(change.constants), bodies(forces)
        _, before, rows, states, _ = self._pieces
        again = self._chain._replace(
            x=states[0, 0].copy(), v=states[0, 1].copy(), state=self._state.copy()
        )
        for (piece, _), row, count in self._calls():
            by_path = np.empty((len(dx), 0))
            if self.imposed:
                by_path = self.imposed.push(self._times(row, count), change.drive, 0)
            tangent(
                self._less, again, self._table, self._course, self._room, self._path(row, count),
                before[piece], rows[piece], count, near, np.empty((2, 1)), (*fixed, by_path), dx, dv, (columns, looks),
            )  # fmt: skip
        if self.imposed and self._driven:
            for order in (0, 1):
                own = self.imposed.push(self.time, change.drive, order)
                looks[:, order][:, :, self.grains == 1] = own[..., None]
        return looks[:, 0], looks[:, 1]
