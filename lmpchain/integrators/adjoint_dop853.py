"""Exact derivatives of a run of a damped chain by DOP853: its discrete adjoint and its tangent.

As in `adjoint`, the result is the derivative of the numbers that the run gives, to round-off. The
run leaves a checkpoint now and then, from which the way back makes the stages of a few steps once
more, and takes adjoints back through them.
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
from .dop853 import DormandPrince
from .kernels import adjoint_dop853 as kernels
from .kernels.adjoint_rows import Law, Way
from .kernels.course import Looks
from .kernels.layout import PAD
from .observed_run import ObservedRun


class Checkpoints(NamedTuple):
    """How far checkpoints of a run are apart.

    Attributes
    ----------
    kept_bytes : int
        For the stages of the steps between two of them, about what stays in the cache.
    total_bytes : int
        Of all of them.
    steps_of_call : int
        In a call of the compiled loops where something is imposed in each.
    """

    kept_bytes: int = 2**19
    total_bytes: int = 2**29
    steps_of_call: int = 2**13


CHECKPOINTS = Checkpoints()


class DifferentiableDampedRun(ObservedRun):
    """A run of a damped chain by given steps of DOP853 with its exact derivatives.

    Parameters, attributes and methods are those of `adjoint.DifferentiableRun`.
    """

    def __init__(
        self,
        scene: Scene,
        method: DormandPrince,
        step: float | list[Array],
        looks: int,
        grains: NDArray[np.intp],
    ):
        super().__init__(scene, step, looks, grains)
        look = np.full(self.steps + 1, -1)
        look[self._before] = np.arange(looks + 1)
        self._steps = kernels.Steps(self._lengths, look)
        self._lay_out(method)
        self._run()

    def _lay_out(self, method: DormandPrince) -> None:
        """Lay out the chain for the compiled loops, and cut the run into pieces."""
        chain = self.scene.chain
        links = self._links
        width = self._x.shape[1]
        mobility = self._mobility
        damped = kernels.Damped(mobility, *np.zeros((5, width)))
        damped.inverse_length[1:] = links.inverse_length[0, :-1]
        damped.strength[1:] = links.strength[0, :-1]
        damped.stiffness[:] = chain.exponent * damped.strength * damped.inverse_length
        damped.viscosity[self._contacts] = chain.contact_viscosity
        # what is held or driven moves as it is told
        damped.drag[self._bodies] = np.where(mobility[self._bodies] > 0, chain.drag, 0.0)
        # a correction for strains serves no contact that only touches, whose strains have no bound
        hertz = chain.exponent == 1.5 and not chain.loose_grains
        law = Law(
            way=int(Way.HERTZ if hertz else Way.OTHER),
            pressed=links.precompressed,
            touching=float(links.uncompressed[0]),
            less=chain.exponent - 1.0,
            terms=links.coefficients,
        )
        if law.touching > 0:
            damped.stiffness[PAD] = chain.exponent * law.touching
        tableau = kernels.Tableau(*method.tables)
        self._system = kernels.System(law, damped, tableau)
        stages = tableau.nodes.size
        # as far apart as the cache allows; further where memory does not hold all
        longest = max(1, CHECKPOINTS.kept_bytes // (3 * 8 * stages * width))
        longest = max(longest, math.ceil(self.steps * 16 * width / CHECKPOINTS.total_bytes))
        starts = np.append(np.arange(0, self.steps, longest), self.steps)
        states = np.empty((starts.size, 2, width))
        states[0] = self._x[0], self._v[0]
        windows = np.empty((starts.size - 1, 2), np.int64)
        self._pieces = kernels.Pieces(starts, states, windows)
        self._longest = min(longest, self.steps)

    @property
    def _bodies(self) -> slice:
        """Grains in a row of bodies."""
        return slice(PAD, PAD + self.scene.chain.grains)

    @property
    def _contacts(self) -> slice:
        """Contacts in a row of those above each body."""
        return slice(PAD, PAD + self.scene.chain.grains + 1)

    def _memory(self, steps: int, others: kernels.Sums | kernels.Rates) -> kernels.Memory:
        """Return arrays for the stages of so many steps, and one stage more."""
        stages = self._system.tableau.nodes.size
        width = self._x.shape[1]
        return kernels.Memory(
            kernels.Stages(*np.zeros((3, steps + 1, stages, width))),
            kernels.Rates(*np.zeros((2, stages, width))),
            others,
        )

    def _calls(self) -> list[NDArray[np.intp]]:
        """Return the pieces, (2,), from the first to the one behind the last, of each call."""
        count = self._pieces.starts.size - 1
        # what is imposed in each stage takes memory
        size = max(1, CHECKPOINTS.steps_of_call // self._longest) if self.imposed else count
        cuts = np.append(np.arange(0, count, size), count)
        return [np.array(cut) for cut in pairwise(cuts)]

    def _times(self, pieces: NDArray[np.intp]) -> Array:
        """Return the times of all stages of some pieces, and of that behind the last step, s."""
        begin, end = self._pieces.starts[pieces]
        steps = slice(begin, end)
        nodes = self._system.tableau.nodes
        times = self._begins[steps, None] + nodes * self._steps.lengths[steps, None]
        return np.append(times, self.time[-1]) if end == self.steps else times.ravel()

    def _run(self) -> None:
        """Move on to the end, with checkpoints at the begin of every piece."""
        bodies, values = self._looks
        start = self._pieces.states[0][:, bodies].copy()
        memory = self._memory(0, kernels.Rates(*np.zeros((2, 1, 1))))
        for pieces in self._calls():
            path = self._path(pieces)
            kernels.forward(
                self._chains,
                self._system,
                self._steps,
                self._pieces,
                pieces,
                path,
                self._looks,
                memory,
            )
        # rounded where it was made of reduced velocities
        values[:, 0] = start
        self._fill_motion_of_driven(values)

    def pull(self, displacement: Array, velocity: Array, everywhere: bool = True) -> Inputs:
        """Return the derivatives of an answer by all inputs, from those by what was seen.

        See `adjoint.DifferentiableRun.pull`.
        """
        chain = self.scene.chain
        looks = np.array([displacement, velocity], dtype=float)
        by_course = np.zeros(self.imposed.size if self.imposed else 0)
        # what is seen of a driven grain is what its motion says, and no grain moves it
        if self.imposed and self._driven:
            for order in (0, 1):
                seen = looks[order][:, self.grains == 1]
                by_course += self.imposed.pull(self.time, seen.sum(-1), order)
                looks[order][:, self.grains == 1] = 0.0
        width = self._x.shape[1]
        stages = self._system.tableau.nodes.size
        x, w, power, force, viscosity, mass, drag, *room = np.zeros((11, width))
        sums = kernels.Sums(
            x, w, power, force, viscosity, mass, drag, np.zeros((stages, width)), *room
        )
        # a grain that the run never moves would have moved from another start
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
        # what is seen at t = 0 is the start itself
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
        memory = self._memory(0, kernels.Rates(*np.zeros((2, stages + 1, width))))
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
