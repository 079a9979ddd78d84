"""Exact derivatives of a damped chain's run by DOP853: discrete adjoint and tangent.

As in `adjoint`, the result is the derivative of the computed motion, exact up to rounding. The run
stores checkpoints, from which the backward pass repeats the stages of a few steps and then
propagates adjoints backward through these stages.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import Scene
from ..util.arrays import Array
from .adjoint import Inputs, by_contacts
from .batch import ChainBatch
from .kernels import adjoint_dop853 as kernels
from .kernels.adjoint_rows import AdjointForce, Way
from .kernels.dop853 import Weighted
from .kernels.layout import PAD, Noted
from .kernels.sample_loop import Looks
from .methods import DormandPrince
from .observed_run import ObservedRun, schedule_of
from .stepper import NativeStepper, room_for
from .steps import Steps


class Dop853Checkpoints(NamedTuple):
    """Distances of checkpoints.

    Attributes
    ----------
    kept_bytes : int
        Memory for the stages of the steps between two checkpoints, about the size of the cache,
        bytes.
    fewest_steps : int
        Smallest number of steps between two checkpoints.
    total_bytes : int
        Approximate memory for all checkpoints, bytes.
    noted_bytes : int
        Memory for the checkpoints of one call of the compiled march, bytes.
    steps_of_call : int
        Number of steps in a call of the compiled loops if a force or motion is imposed.
    """

    kept_bytes: int = 2**19
    fewest_steps: int = 4
    total_bytes: int = 2**29
    noted_bytes: int = 2**20
    steps_of_call: int = 2**13


CHECKPOINTS = Dop853Checkpoints()


class Followed(NamedTuple):
    """A run of the native engine: steps up to each observation, checkpoints and observed motion.

    Attributes
    ----------
    steps : list of arrays
        Lengths of the steps between successive observations, s; one array for each observation
        after t = 0.
    pieces : kernels.Dop853Pieces
        Pieces of the run between checkpoints, with the checkpoints.
    values : (2, looks+1, G) array
        Displacements, m, and velocities, m/s, of the observed grains.
    """

    steps: list[Array]
    pieces: kernels.Dop853Pieces
    values: Array


def follow(
    scene: Scene,
    method: DormandPrince,
    schedule: Steps,
    looks: int,
    grains: NDArray[np.intp],
) -> Followed:
    """Run the march of the native engine, and return the data for the backward pass."""
    batch = ChainBatch([scene.replace(samples=looks + 1)])
    run = NativeStepper(batch, method, schedule, {})
    width = batch.arrays.inverse_mass.shape[1]
    # Adaptive steps are at most about four times as many as equal ones.
    expected = looks * schedule.per_landing * (4 if schedule.adaptive else 1)
    # The cache limits the distance of checkpoints, memory limits their number.
    every = CHECKPOINTS.kept_bytes // (3 * 8 * method.evaluations * width)
    every = max(
        CHECKPOINTS.fewest_steps, every, math.ceil(expected * 16 * width / CHECKPOINTS.total_bytes)
    )
    count = max(1, min(CHECKPOINTS.noted_bytes // (16 * width), math.ceil(expected / every)))
    values = np.empty((2, looks + 1, grains.size))
    values[:, 0] = np.array(scene.initial())[:, grains - 1]
    calls: list[Noted] = []
    while run.sample < looks:
        look = run.sample
        ends = np.empty(every * count)
        noted = Noted(ends, every, np.empty((count, 2, width)), np.empty((count, 2), np.int64))
        until = min(looks, look + ends.size)
        u, v = room_for(1, until - look + 1, scene.chain.grains)
        made = run.fill_by_step(u, v, look, until, noted)
        seen = slice(1, run.sample - look + 1)
        values[0, look + 1 : run.sample + 1] = u[0, seen][:, grains - 1]
        values[1, look + 1 : run.sample + 1] = v[0, seen][:, grains - 1]
        pieces = math.ceil(made / every)
        calls.append(Noted(ends[:made], every, noted.states[:pieces], noted.windows[:pieces]))
    final = run.watched["first"], run.watched["last"]
    ends = np.concatenate([noted.ends for noted in calls])
    # The window is widest at the end of a piece.
    windows = np.concatenate([*(noted.windows for noted in calls), np.array(final).T])[1:]
    sizes = [noted.ends.size for noted in calls]
    before = np.cumsum(sizes) - sizes
    starts = [n + np.arange(0, size, every) for n, size in zip(before, sizes, strict=True)]
    states = np.concatenate([noted.states for noted in calls])
    pieces = kernels.Dop853Pieces(np.append(np.concatenate(starts), ends.size), states, windows)
    landings = ends == 0.0
    lengths = np.where(landings, scene.duration / looks, ends) - np.append(0.0, ends[:-1])
    steps = np.split(lengths, np.flatnonzero(landings)[:-1] + 1)
    return Followed(steps, pieces, values)


class DifferentiableDampedRun(ObservedRun):
    """A run of a damped chain by DOP853 with exact derivatives at constant steps.

    See `adjoint.DifferentiableRun` for the parameters, attributes and methods. With `adaptive`,
    steps are shorter near the opening and closing of contacts, and derivatives are taken at
    constant steps.
    """

    def __init__(
        self,
        scene: Scene,
        method: DormandPrince,
        step: float,
        looks: int,
        grains: NDArray[np.intp],
        adaptive: bool = False,
    ):
        schedule = schedule_of(scene, step, looks, adaptive)
        followed = follow(scene, method, schedule, looks, np.asarray(grains))
        super().__init__(scene, followed.steps, looks, grains)
        look = np.full(self.steps + 1, -1)
        look[self._before] = np.arange(looks + 1)
        self._steps = kernels.StepsAndLooks(self._lengths, look)
        self._pieces = followed.pieces
        self._longest = int(np.diff(self._pieces.starts).max())
        self._lay_out(method)
        self._looks.values[:] = followed.values
        self._fill_motion_of_driven(self._looks.values)

    def _lay_out(self, method: DormandPrince) -> None:
        """Prepare the chain for the compiled loops."""
        chain = self.scene.chain
        arrays = self._arrays
        width = self._x.shape[1]
        mobility = self._mobility
        damped = kernels.Damped(mobility, *np.zeros((5, width)))
        damped.inverse_length[1:] = arrays.inverse_length[0, :-1]
        damped.strength[1:] = arrays.strength[0, :-1]
        exponent = chain.law.power_of("derivatives of a run")
        damped.stiffness[:] = exponent * damped.strength * damped.inverse_length
        damped.viscosity[self._contacts] = chain.contact_viscosity
        # Held and driven grains have no drag.
        damped.drag[self._bodies] = np.where(mobility[self._bodies] > 0, chain.drag, 0.0)
        # The "corrected" form uses strains, and the strain of a touching contact is unbounded.
        hertz = exponent == 1.5 and not chain.loose_grains
        law = AdjointForce(
            way=int(Way.HERTZ if hertz else Way.OTHER),
            pressed=arrays.precompressed,
            touching=float(arrays.uncompressed[0]),
            less=exponent - 1.0,
            terms=arrays.coefficients,
        )
        if law.touching > 0:
            damped.stiffness[PAD] = exponent * law.touching
        tableau = kernels.Tableau(*method.tables)
        # See `layout.BatchArrays`.
        alike = arrays.alike
        lag = float(chain.contact_viscosity[0]) if alike else 0.0
        self._system = kernels.DampedSystem(law, damped, tableau, not alike, lag)

    @property
    def _bodies(self) -> slice:
        """Slice of the grains in a row of bodies."""
        return slice(PAD, PAD + self.scene.chain.grains)

    @property
    def _contacts(self) -> slice:
        """Slice of the contacts in a row of the contacts above the bodies."""
        return slice(PAD, PAD + self.scene.chain.grains + 1)

    def _memory(
        self, steps: int, others: kernels.AdjointSums | kernels.StageRates
    ) -> kernels.Dop853Memory:
        """Allocate arrays for the stages of a number of steps, and for one more stage."""
        stages = self._system.tableau.nodes.size
        width = self._x.shape[1]
        return kernels.Dop853Memory(
            kernels.StageStates(*np.zeros((3, steps + 1, stages, width))),
            kernels.rates_of(np.zeros((2 * stages, width))),
            Weighted(np.zeros(2 * stages), np.zeros(2 * stages, np.int64)),
            others,
        )

    def _calls(self) -> list[NDArray[np.intp]]:
        """Return the range of pieces of each call: the first one, and the one after the last."""
        count = self._pieces.starts.size - 1
        # An imposed force or motion is stored for each stage of a call.
        size = max(1, CHECKPOINTS.steps_of_call // self._longest) if self.imposed else count
        cuts = np.append(np.arange(0, count, size), count)
        return [np.array(cut) for cut in pairwise(cuts)]

    def _times(self, pieces: NDArray[np.intp]) -> Array:
        """Return the times of all stages of pieces, and the end of the last step, s."""
        begin, end = self._pieces.starts[pieces]
        steps = slice(begin, end)
        nodes = self._system.tableau.nodes
        times = self._begins[steps, None] + nodes * self._steps.lengths[steps, None]
        return np.append(times, self.time[-1]) if end == self.steps else times.ravel()

    def pull(self, displacement: Array, velocity: Array, everywhere: bool = True) -> Inputs:
        """Return the gradient of a result over all inputs, given that over the observed motion.

        See `adjoint.DifferentiableRun.pull` for the parameters.
        """
        chain = self.scene.chain
        looks = np.array([displacement, velocity], dtype=float)
        by_course = np.zeros(self.imposed.size if self.imposed else 0)
        # The motion of a driven grain is prescribed.
        if self.imposed and self._driven:
            for order in (0, 1):
                seen = looks[order][:, self.grains == 1]
                by_course += self.imposed.pull(self.time, seen.sum(-1), order)
                looks[order][:, self.grains == 1] = 0.0
        width = self._x.shape[1]
        stages = self._system.tableau.nodes.size
        x, w, power, force, viscosity, mass, drag, *room = np.zeros((11, width))
        sums = kernels.AdjointSums(
            x, w, power, force, viscosity, mass, drag, np.zeros((stages, width)), *room
        )
        # A grain that never moves would move if the initial state were different.
        pieces = self._pieces
        if everywhere:
            pieces = pieces._replace(windows=np.full_like(pieces.windows, (PAD, width - PAD)))
        derivatives = Looks(self._looks.bodies, looks)
        memory = self._memory(self._longest, sums)
        for numbers in reversed(self._calls()):
            path = self._path(numbers)
            kernels.backward(
                self._chains,
                self._system,
                self._steps,
                pieces,
                numbers,
                path,
                derivatives,
                memory,
            )
            if self.imposed:
                by_course += self.imposed.pull(self._times(numbers), path.derivative, 0)
        # The observation at t = 0 is the initial state itself.
        np.add.at(x, self._looks.bodies, looks[0, 0])
        np.add.at(w, self._looks.bodies, looks[1, 0])
        by_constant, by_rest = by_contacts(
            chain.contacts, power[self._contacts], force[self._contacts]
        )
        fixed = self._system.damped.inverse_mass[self._bodies] == 0
        return Inputs(
            masses=-mass[self._bodies] / chain.masses,
            constants=by_constant,
            forces=by_rest,
            displacement=np.where(fixed, 0.0, x[self._bodies]),
            velocity=np.where(fixed, 0.0, w[self._bodies]),
            drive=by_course,
            viscosity=viscosity[self._contacts],
            drag=np.where(fixed, 0.0, -drag[self._bodies]),
        )

    def push(self, change: Inputs) -> tuple[Array, Array]:
        """Return the changes of displacement and velocity, (D, looks+1, G), in D directions."""
        contacts = self.scene.chain.contacts
        width = self._x.shape[1]

        def wide(rows: Array, place: slice) -> Array:
            row = np.zeros((*rows.shape[:-1], width))
            row[..., place] = rows
            return row

        fixed = self._system.damped.inverse_mass[self._bodies] == 0
        none = np.zeros(contacts.constant.size)
        inverse = np.divide(1.0, contacts.constant, out=none, where=contacts.exists)
        changes = kernels.Change(
            x=wide(np.where(fixed, 0.0, change.displacement), self._bodies),
            w=wide(np.where(fixed, 0.0, change.velocity), self._bodies),
            mass=wide(change.masses / self.scene.chain.masses, self._bodies),
            constant=wide(change.constants, self._contacts),
            force=wide(np.where(contacts.pressed, change.forces, 0.0), self._contacts),
            viscosity=wide(change.viscosity, self._contacts),
            drag=wide(np.where(fixed, 0.0, change.drag), self._bodies),
            path=np.empty((len(change.masses), 0)),
            inverse_constant=wide(inverse, self._contacts),
            at_rest=wide(contacts.force, self._contacts),
        )
        looks = self._looks._replace(values=np.zeros((len(changes.x), *self._looks.values.shape)))
        start = np.stack((changes.x, changes.w), 1)[..., looks.bodies]
        self._x[0], self._v[0] = self._pieces.states[0]
        self._state["first"] = PAD
        self._state["last"] = width - PAD
        stages = self._system.tableau.nodes.size
        memory = self._memory(0, kernels.rates_of(np.zeros((2 * stages + 2, width))))
        for pieces in self._calls():
            if self.imposed:
                by_path = self.imposed.push(self._times(pieces), change.drive, 0)
                changes = changes._replace(path=by_path)
            span = self._pieces.starts[pieces]
            path = self._path(pieces)
            kernels.tangent(
                self._chains, self._system, self._steps, span, path, looks, memory, changes
            )
        looks.values[:, :, 0] = start
        self._fill_change_of_driven(looks.values, change.drive)
        return looks.values[:, 0], looks.values[:, 1]
