"""Exact derivatives of a run by a kick-drift splitting: discrete adjoint and tangent.

The run is a sequence of kicks and drifts, and the adjoint propagates derivatives with respect to
the observed motion backward through them. The result is the derivative of the computed motion,
exact up to rounding, and it differs from the derivative of the exact solution by the error of the
steps. For delta > 1 the force and stiffness of a contact that opens or closes are continuous. For
delta = 1 the stiffness jumps: the result is the derivative for contacts that open and close at the
same evaluations. This is the derivative of the computed motion unless an evaluation falls exactly
on an opening. It converges to the derivative of the exact solution at first order in the step.

The loops of the native engine compute the run and store checkpoints. If all contacts are pressed at
rest and never open, and delta is 3/2 or the wave is so weak that a series suffices, the backward
pass undoes the steps between two checkpoints while it propagates adjoints. Otherwise rounding would
open or close contacts if the steps were undone. The backward pass then repeats these steps and
stores one number for each contact and evaluation, which fit into the cache.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly, poly2cheb
from numpy.typing import NDArray

from ..chain.chain import Chain
from ..chain.contact_law import Contacts
from ..scene.scene import Scene
from ..util.arrays import Array
from .kernels import adjoint as kernels
from .kernels.adjoint_rows import Above, Adjoint, AdjointForce, Bodies, Way
from .kernels.adjoint_tangent import Directions, ForceResponse, tangent
from .kernels.contact_forces import ROOTS, Form
from .kernels.layout import PAD, BatchArrays
from .kernels.sample_loop import Course, Looks, Stretch
from .methods import Splitting
from .observed_run import ObservedRun


class Checkpoints(NamedTuple):
    """Distances of checkpoints.

    A row is a kick and a drift, see `kernels.adjoint`.

    Attributes
    ----------
    kept_bytes : int
        Memory for the rows between two checkpoints, about the size of the cache, bytes.
    fewest_rows : int
        Smallest number of rows between two checkpoints.
    undone_rows : int
        Number of rows between two checkpoints if steps are undone. With 8 to 512 rows, derivatives
        agree to 7e-14.
    total_bytes : int
        Memory for all checkpoints, bytes.
    rows_of_call : int
        Number of rows in a call of the compiled loops if a force or motion is imposed.
    """

    kept_bytes: int = 2**19
    fewest_rows: int = 32
    undone_rows: int = 256
    total_bytes: int = 2**29
    rows_of_call: int = 2**16


class Pages(NamedTuple):
    """Distance of rows of the backward pass in numbers, modulo a page.

    A load from memory is delayed by a store to the same offset in another page. The distance
    `stride` avoids equal offsets; `size` is the length of a page.
    """

    size: int = 512
    stride: int = 360


CHECKPOINTS = Checkpoints()
PAGES = Pages()
# Safety factor on the largest strain, which may occur between two checkpoints.
UNSEEN = 2.0
# Number of coefficients that `economise` needs for small strains; larger strains need 6.
SHORT = 4


class Inputs(NamedTuple):
    """Inputs of a motion, or derivatives with respect to them, or directions (D, ...) of change.

    Attributes
    ----------
    masses : (N,) array
        Masses, kg. A derivative by a mass is taken at constant forces at rest.
    constants : (N+1,) array
        Constants K_n of all contacts, including those with walls, N/m^delta. A derivative by a
        constant is taken at constant forces at rest.
    forces : (N+1,) array
        Force of every contact at rest, N; 0 for contacts that carry no force at rest.
    displacement : (N,) array
        Displacement of every grain at t = 0, m.
    velocity : (N,) array
        Velocity of every grain at t = 0, m/s.
    drive : (P,) array
        Amplitude and frequency of a drive or a force, or its samples.
    viscosity : (N+1,) array
        Viscosity A of all contacts, s; 0 for a run by a splitting, which has no damping.
    drag : (N,) array
        Drag gamma of every grain, 1/s; 0 for a run by a splitting, which has no damping.
    """

    masses: Array
    constants: Array
    forces: Array
    displacement: Array
    velocity: Array
    drive: Array
    viscosity: Array
    drag: Array

    def __add__(self, other: Any) -> Inputs:
        return Inputs(*(value + added for value, added in zip(self, other, strict=True)))


class Call(NamedTuple):
    """The pieces of a run in one call of a compiled loop.

    Attributes
    ----------
    pieces : (2,) array
        Number of the first piece, and number of the last piece plus 1.
    row : int
        Number of the first row.
    rows : int
        Number of rows.
    """

    pieces: NDArray[np.intp]
    row: int
    rows: int


def make_aligned(rows: int, width: int) -> Array:
    """Return an array of zeros (rows, width) whose memory is aligned to cache lines."""
    memory = np.zeros(rows * width + PAD)
    skip = -memory.ctypes.data // memory.itemsize % PAD
    return memory[skip : skip + rows * width].reshape(rows, width)


def by_contacts(contacts: Contacts, by_power: Array, by_force: Array) -> tuple[Array, Array]:
    """Return the gradient over the constants and rest forces of all contacts, (N+1,) arrays.

    `by_power` and `by_force` are the sums over all evaluations of y p and y f. Here y is the
    derivative by the force of a contact, and `kernels.adjoint` defines p and f. The derivatives by
    the constants are taken at constant forces at rest.
    """
    by_constant = by_force - contacts.force * by_power
    none = np.zeros(by_power.size)
    return (
        np.divide(by_constant, contacts.constant, out=none, where=contacts.exists),
        np.where(contacts.pressed, by_power, 0.0),
    )


def economise(exponent: float, reach: float) -> Array:
    """Return a polynomial for ((1 + s)^exponent - 1) / s, |s| <= reach: (4,) or (6,) coefficients.

    The polynomial is the economised binomial series. For delta = 3/2, four coefficients are exact
    up to |s| = 3e-4 and six up to 0.007. Six coefficients have an error of 4e-15 at |s| = 0.0126.
    """
    k = np.arange(12)
    reach = min(max(reach, 1e-6), 0.02)
    series = poly2cheb(np.cumprod((exponent - k) / (k + 1)) * reach**k)
    terms = SHORT if np.abs(series[SHORT:]).sum() <= 1e-16 * abs(series[0]) else 6
    # The function cheb2poly removes trailing zeros.
    coefficients = cheb2poly(series[:terms])
    return np.pad(coefficients, (0, terms - coefficients.size)) / reach ** np.arange(terms)


class DifferentiableRun(ObservedRun):
    """A run with prescribed steps and its exact derivatives.

    Parameters
    ----------
    scene : Scene
        Scene of the run.
    method : Splitting
        Integration method.
    step : float, or sequence of `looks` arrays
        Longest step, s, of a run with equal steps, which divide the time between two observations.
        A sequence of arrays prescribes all steps between successive observations, s.
    looks : int
        Number of equal parts of the duration. Grains are observed at the end of each part.
    grains : (G,) array
        Numbers of the observed grains, from 1.

    Attributes
    ----------
    time : (looks+1,) array
        Times of the observations, from 0 to the duration, s.
    step : float
        Longest step, s.
    displacement : (looks+1, G) array
        Displacement of the observed grains, m.
    velocity : (looks+1, G) array
        Velocity of the observed grains, m/s.
    law : AdjointForce
        Contact law for the compiled loops.
    """

    def __init__(
        self,
        scene: Scene,
        method: Splitting,
        step: float | list[Array],
        looks: int,
        grains: NDArray[np.intp],
    ):
        super().__init__(scene, step, looks, grains)
        self._reach = np.array((0.0, *method.reach[:-1]))
        self._course = Course(
            np.array(method.kicks), np.array(method.drifts), self._lengths, self._before
        )
        # Rows before each observation: one for each stage, and one for the last kick.
        self._offsets = method.evaluations * self._before + np.arange(looks + 1)
        self._lay_out(scene.chain)
        self._cut()
        self._run()

    def _lay_out(self, chain: Chain) -> None:
        """Prepare the contacts for the compiled loops."""
        arrays = self._arrays
        width = self._x.shape[1]
        # In the backward pass a contact has the index of the body below it.
        above = make_aligned(3, width)
        above[0, 1:] = arrays.inverse_length[0, :-1]
        above[1, 1:] = arrays.strength[0, :-1]
        exponent = chain.law.power_of("derivatives of a run")
        above[2] = exponent * above[1] * above[0]
        self._above = Above(*above)
        way = _way(chain, arrays)
        less = exponent - 1.0
        self.law = AdjointForce(
            way=int(way),
            pressed=arrays.precompressed,
            touching=float(arrays.uncompressed[0]),
            less=less,
            terms=arrays.coefficients,
        )
        self._undone = way <= Way.UNDONE_SHORT
        self._room = np.zeros((5, 2 * kernels.BURST))

    def _cut(self) -> None:
        """Cut the run into pieces between checkpoints."""
        width = self._x.shape[1]
        rows = int(self._offsets[-1])
        # Rounding or the cache limits the distance of checkpoints; memory limits their number.
        longest = CHECKPOINTS.undone_rows
        if not self._undone:
            longest = max(CHECKPOINTS.fewest_rows, CHECKPOINTS.kept_bytes // (8 * width))
        longest = max(longest, math.ceil(rows * 16 * width / CHECKPOINTS.total_bytes))
        starts = np.append(np.arange(0, rows, longest), rows)
        looks = np.searchsorted(self._offsets, starts, side="right") - 1
        states = np.empty((starts.size, 2, width))
        states[0] = self._x[0], self._v[0]
        windows = np.empty((starts.size - 1, 2), np.int64)
        self._pieces = kernels.Pieces(starts, looks, starts - self._offsets[looks], states, windows)
        self._longest = min(longest, rows)

    def _times(self, row: int, count: int) -> Array:
        """Return the times of rows, s."""
        rows = np.arange(row, row + count)
        look = np.searchsorted(self._offsets, rows, side="right") - 1
        step, stage = np.divmod(rows - self._offsets[look], len(self._reach))
        step += self._course.begun[look]
        # The last kick before an observation belongs to the step that ends there.
        last = step == self._course.begun[look + 1]
        step = np.where(last, step - 1, step)
        inside = self._begins[step] + self._reach[stage] * self._course.lengths[step]
        return np.where(last, self.time[look + 1], inside)

    def _calls(self) -> list[Call]:
        """Return the calls of a compiled loop for one pass through the run."""
        starts = self._pieces.starts
        size = starts.size
        # An imposed force or motion is stored for each row of a call.
        if self.imposed is not None:
            size = max(1, CHECKPOINTS.rows_of_call // self._longest)
        cuts = np.append(np.arange(0, starts.size - 1, size), starts.size - 1)
        return [
            Call(np.array((first, stop)), int(starts[first]), int(starts[stop] - starts[first]))
            for first, stop in pairwise(cuts)
        ]

    def _run(self) -> None:
        """Integrate to the end, with checkpoints at the beginning of every piece."""
        bodies, values = self._looks
        values[:, 0] = self._x[0, bodies], self._v[0, bodies]
        for pieces, row, count in self._calls():
            path = self._path(row, count).imposed
            kernels.forward(
                self._chains, self._course, self._room, path, self._pieces, pieces, self._looks
            )
        self._fill_motion_of_driven(values)

    def pull(self, displacement: Array, velocity: Array, everywhere: bool = True) -> Inputs:
        """Return the gradient of a result over all inputs, given that over the observed motion.

        Parameters
        ----------
        displacement : (looks+1, G) array
            Derivative of the result with respect to each observed displacement, 1/m.
        velocity : (looks+1, G) array
            Derivative of the result with respect to each observed velocity, s/m.
        everywhere : bool
            Whether to compute derivatives by displacement and velocity at t = 0 also for grains
            that never move. Otherwise the backward pass is limited to the light cone of the run.
        """
        chain = self.scene.chain
        grains = chain.grains
        looks = np.array([displacement, velocity], dtype=float)
        by_course = np.zeros(self.imposed.size if self.imposed else 0)
        # The motion of a driven grain is prescribed.
        if self.imposed and self._driven:
            by_x, by_v = looks[..., self.grains == 1].sum(-1)
            by_course += self.imposed.pull(self.time, by_v, 1)
            by_course += self.imposed.pull(self.time[:1], by_x[:1], 0)
            looks[1][:, self.grains == 1] = 0.0
        width = self._x.shape[1]
        long = width + PAD + (PAGES.stride - width - PAD) % PAGES.size
        adjoint, bodies, above = np.split(make_aligned(11, long), (5, 8))
        bodies[2, 1 : width + 1] = self._mobility
        above[:, :width] = self._above
        law = self.law
        # The polynomial depends on the strains of this run, which are known only now.
        if law.way == Way.UNDONE_SERIES:
            terms = economise(law.less, min(UNSEEN * self._strain, self.scene.largest_strain))
            way = Way.UNDONE_SHORT if terms.size == SHORT else Way.UNDONE_SERIES
            law = law._replace(way=int(way), terms=terms)
        memory = kernels.Memory(
            bodies=Bodies(*bodies),
            adjoint=Adjoint(*adjoint),
            above=Above(*above),
            powers=make_aligned(1 if self._undone else self._longest, width),
            forces=make_aligned(self._longest if law.way == Way.OTHER else 1, width),
            tops=np.empty((2, self._longest)),
            room=self._room,
        )
        # A grain that never moves would move if the initial state were different.
        pieces = self._pieces
        if everywhere:
            pieces = pieces._replace(windows=np.full_like(pieces.windows, (PAD, width - PAD)))
        derivatives = Looks(self._looks.bodies, looks)
        for numbers, row, count in reversed(self._calls()):
            path = self._path(row, count)
            kernels.backward(law, self._course, pieces, numbers, derivatives, path, memory)
            if self.imposed:
                by_course += self.imposed.pull(self._times(row, count), path.derivative, 0)
        # The observation at t = 0 is the initial state itself.
        x, pull, _, _, by_mass = adjoint[:, PAD + 1 : PAD + 1 + grains]
        v = pull * chain.masses
        np.add.at(x, self.grains - 1, looks[0, 0])
        np.add.at(v, self.grains - 1, looks[1, 0])
        by_power, by_force = adjoint[2:4, PAD : PAD + grains + 1]
        stiffness = above[2, PAD : PAD + grains + 1]
        by_power = np.divide(by_power, stiffness, out=np.zeros(grains + 1), where=stiffness > 0)
        by_constant, by_rest = by_contacts(chain.contacts, by_power, by_force)
        fixed = self._mobility[PAD : PAD + grains] == 0
        return Inputs(
            masses=-by_mass / chain.masses,
            constants=by_constant,
            forces=by_rest,
            displacement=np.where(fixed, 0.0, x),
            velocity=np.where(fixed, 0.0, v),
            drive=by_course,
            viscosity=np.zeros(grains + 1),
            drag=np.zeros(grains),
        )

    def push(self, change: Inputs) -> tuple[Array, Array]:
        """Return the changes of displacement and velocity, (D, looks+1, G), in D directions."""
        chain = self.scene.chain
        contacts = chain.contacts
        width = self._x.shape[1]
        grains = chain.grains

        def bodies(rows: Array) -> Array:
            wide = np.zeros((len(rows), width))
            wide[:, PAD : PAD + rows.shape[1]] = rows
            return wide

        def links(rows: Array) -> Array:
            wide = np.zeros(width)
            wide[PAD : PAD + grains + 1] = rows
            return wide

        fixed = self._mobility[PAD : PAD + grains] == 0
        inverse = np.divide(1.0, contacts.constant, out=np.zeros(grains + 1), where=contacts.exists)
        power, force, slope, soften = np.zeros((4, width))
        response = ForceResponse(power, force, slope, soften, links(inverse), links(contacts.force))
        changes = Directions(
            x=bodies(np.where(fixed, 0.0, change.displacement)),
            v=bodies(np.where(fixed, 0.0, change.velocity)),
            mass=bodies(change.masses / chain.masses),
            constant=bodies(change.constants),
            force=bodies(np.where(contacts.pressed, change.forces, 0.0)),
            path=np.empty((len(change.masses), 0)),
        )
        looks = self._looks._replace(values=np.zeros((len(changes.x), *self._looks.values.shape)))
        looks.values[:, 0, 0] = changes.x[:, looks.bodies]
        looks.values[:, 1, 0] = changes.v[:, looks.bodies]
        # Deviations need no checkpoints, because one call continues the other.
        pieces = self._pieces
        x, v = pieces.states[0].copy()
        moved = Bodies(x, v, self._mobility)
        memory = self._above, response, self._room
        for (piece, _), row, count in self._calls():
            if self.imposed:
                by_path = self.imposed.push(self._times(row, count), change.drive, 0)
                changes = changes._replace(path=by_path)
            stretch = Stretch(int(pieces.looks[piece]), int(pieces.rows[piece]), count)
            path = self._path(row, count)
            tangent(moved, self.law, self._course, stretch, path, memory, changes, looks)
        self._fill_change_of_driven(looks.values, change.drive)
        return looks.values[:, 0], looks.values[:, 1]

    @property
    def _strain(self) -> float:
        """Largest strain of any contact, of either sign, at the end of any row."""
        state = self._state[0]
        closer = state["largest_approach"] * self._above.inverse_length.max()
        return float(max(-state["least_strain"], closer))


def _way(chain: Chain, arrays: BatchArrays) -> Way:
    """Return the type of backward pass for a chain."""
    # Steps can be undone if no contact opens. Rounding would close or open touching contacts.
    form = arrays.form[0]
    hertz = chain.law.power == 1.5
    if chain.linearisable and not arrays.uncompressed[0]:
        if form == Form.POLYNOMIAL:
            return Way.UNDONE_SERIES
        if hertz:
            return Way.UNDONE_PLAIN if form in ROOTS else Way.UNDONE_EXACT
    if not hertz:
        return Way.OTHER
    if not arrays.precompressed:
        return Way.VACUUM
    if form in ROOTS:
        return Way.PLAIN
    return Way.OTHER if chain.loose_grains else Way.HERTZ
