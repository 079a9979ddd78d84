"""What one may want of a motion: a number, and its derivatives by the motion and the chain.

An objective looks at some grains at times that are equal parts of the duration: at the samples of the scene or, where
it is `dense`, so often that the fastest motion turns by a quarter of a radian at most in between, and twice as often
whenever the steps of a gradient are halved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import InputError, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from .seen import Seen, Slopes, contact_force, quadrature


class Objective(Protocol):
    """A number that one wants of a motion."""

    @property
    def dense(self) -> bool:
        """Whether it needs times between the samples."""

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains that it looks at; raises `InputError` if the scene has not what it needs."""

    def __call__(self, seen: Seen) -> Slopes:
        """Return its value and derivatives."""


def _known(scene: Scene, grains: Sequence[int]) -> Sequence[int]:
    """Return these grains; raises `InputError` unless all are among those of the scene."""
    if not len(grains) or min(grains) < 1 or max(grains) > scene.chain.grains:
        raise InputError(
            [("grains", f"must be some of 1 to {scene.chain.grains} (got {shown(list(grains))})")]
        )
    return grains


def _still(scene: Scene, contact: int) -> None:
    """Raise `InputError` if this contact is with a wall that moves."""
    if contact == 0 and scene.drive is not None and scene.drive.grain == 0:
        raise InputError(
            [("objective", "cannot look at the contact with a wall that moves: use other grains")]
        )


@dataclass(frozen=True)
class PeakForce:
    """The peak force at a contact, N, that at rest included: a smooth maximum over time.

    It is the mean of the force F over time with weights F^sharpness, which is below the peak by some
    1 / (2 sharpness) of it, and at most the peak: 0.5 % where the sharpness is 100.

    Parameters
    ----------
    contact : int
        n, below grain n; 0 is at the top wall and N at the bottom one.
    sharpness : float
    """

    contact: int
    sharpness: float = 100.0
    dense = True

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains at either end of the contact."""
        exists = scene.chain.contacts.exists
        if not (0 <= self.contact < exists.size and exists[self.contact]):
            numbers = np.flatnonzero(exists)
            raise InputError(
                [
                    (
                        "contact",
                        f"must be one of {numbers[0]} to {numbers[-1]} (got {shown(self.contact)})",
                    )
                ]
            )
        _still(scene, self.contact)
        if not self.sharpness > 0:
            raise InputError([("sharpness", f"must be above 0 (got {shown(self.sharpness)})")])
        return [
            grain for grain in (self.contact, self.contact + 1) if 1 <= grain <= scene.chain.grains
        ]

    def __call__(self, seen: Seen) -> Slopes:
        """Return the smooth maximum and its derivatives."""
        force, by_closer, by_force, by_constant, ends = contact_force(seen, self.contact)
        largest = force.max()
        if largest == 0:
            return seen.slopes(0.0)
        part = force / largest
        weight = quadrature(part.size) * part**self.sharpness
        weight /= weight.sum()
        value = float(largest * (weight @ part))
        ratio = np.divide(value, force, out=np.zeros(force.size), where=part > 1e-3)
        slope = weight * (1 + self.sharpness * (1 - ratio))
        slopes = seen.slopes(value)
        for grain in ends:
            slopes.displacement[:, seen.column(grain)] = (
                slope * by_closer * (1 if grain == self.contact else -1)
            )
        slopes.forces[self.contact], slopes.constants[self.contact] = (
            slope @ by_force,
            slope @ by_constant,
        )
        return slopes


@dataclass(frozen=True)
class _AtATime:
    """Something of a group of grains at one of the samples.

    Parameters
    ----------
    group : sequence of int
        Numbers of the grains.
    time : float, optional
        s; by default the end. The nearest sample is taken.
    """

    group: Sequence[int]
    time: float | None = None
    dense = False

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the group."""
        if self.time is not None and not 0 <= self.time <= scene.duration:
            raise InputError(
                [("time", f"must be from 0 to {scene.duration:g} s (got {shown(self.time)})")]
            )
        return _known(scene, self.group)

    def _look(self, seen: Seen) -> int:
        return -1 if self.time is None else int(np.abs(seen.time - self.time).argmin())


class KineticEnergy(_AtATime):
    """The kinetic energy of a group of grains at one of the samples, J."""

    def __call__(self, seen: Seen) -> Slopes:
        """Return the energy and its derivatives."""
        look, m = self._look(seen), seen.scene.chain.masses[seen.grains - 1]
        v = seen.velocity[look]
        slopes = seen.slopes(float(m @ v**2 / 2))
        slopes.velocity[look], slopes.masses[seen.grains - 1] = m * v, v**2 / 2
        return slopes


class Energy(_AtATime):
    """The energy of a group of grains above rest at one of the samples, J.

    As `measure.energy.shares` parts it: kinetic energy, half of what contacts with other grains hold, less the work
    that load and weight do as they give way, and all of what those with walls do.
    """

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the group and its neighbours."""
        group = super().grains(scene)
        _still(scene, 0 if 1 in group else 1)
        near = {other for grain in group for other in (grain - 1, grain, grain + 1)}
        return sorted(near & set(range(1, scene.chain.grains + 1)))

    def __call__(self, seen: Seen) -> Slopes:
        """Return the energy and its derivatives."""
        look, chain, at = self._look(seen), seen.scene.chain, seen.grains - 1
        inside = np.isin(seen.grains, self.group)
        m, v = np.where(inside, chain.masses[at], 0.0), seen.velocity[look]
        u, share = np.zeros(chain.grains), np.zeros(chain.grains + 1)
        u[at], half = seen.displacement[look], inside / 2
        np.add.at(share, at, half)
        np.add.at(share, at + 1, half)
        share[[0, -1]] *= 2
        contacts = chain.contacts
        r = contacts.closer(u)
        held, change = share * contacts.energy(r), share * contacts.force_change(r)
        more = np.where(contacts.pressed, (held - r * change) / contacts.exponent, -held)
        slopes = seen.slopes(float(m @ v**2 / 2 + held.sum()))
        slopes.displacement[look], slopes.velocity[look] = np.diff(change)[at], m * v
        slopes.masses[at] = inside * v**2 / 2
        slopes.constants[:] = -more / np.where(contacts.exists, contacts.constant, 1.0)
        slopes.forces[:] = np.where(contacts.pressed, held + more, 0.0) / np.where(
            contacts.pressed, contacts.force, 1.0
        )
        return slopes


class Momentum(_AtATime):
    """The momentum of a group of grains at one of the samples, kg m/s, positive downward."""

    def __call__(self, seen: Seen) -> Slopes:
        """Return the momentum and its derivatives."""
        look, m = self._look(seen), seen.scene.chain.masses[seen.grains - 1]
        v = seen.velocity[look]
        slopes = seen.slopes(float(m @ v))
        slopes.velocity[look], slopes.masses[seen.grains - 1] = m, v
        return slopes


@dataclass(frozen=True)
class ArrivalTime:
    """The time at which a grain first moves as fast as a threshold, s.

    Between the times looked at, the velocity is the cubic through the four nearest ones.

    Parameters
    ----------
    grain : int
    velocity : float
        The threshold, m/s; negative for an upward motion.
    """

    grain: int
    velocity: float
    dense = True

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grain."""
        return _known(scene, [self.grain])

    def __call__(self, seen: Seen) -> Slopes:
        """Return the time and its derivatives; raises `InputError` if the grain is never that fast."""
        from scipy.optimize import brentq

        v = seen.velocity[:, seen.column(self.grain)]
        above = np.flatnonzero(np.sign(self.velocity) * v >= abs(self.velocity))
        if not above.size or above[0] == 0:
            what = (
                "has that velocity at once"
                if above.size
                else f"is never faster than {np.abs(v).max():.3g} m/s"
            )
            raise InputError([("velocity", f"grain {self.grain} {what}: use another threshold")])
        first = int(np.clip(above[0] - 2, 0, v.size - 4))
        near, step = v[first : first + 4], seen.time[1]
        nodes = np.arange(4.0)
        basis = [
            np.poly1d(np.poly(np.delete(nodes, k)) / np.prod(k - np.delete(nodes, k)))
            for k in range(4)
        ]
        cubic = sum((b * value for b, value in zip(basis, near, strict=True)), np.poly1d([0.0]))
        here = above[0] - first
        at = brentq(lambda t: cubic(t) - self.velocity, here - 1, here, xtol=1e-14)
        slopes = seen.slopes(float((first + at) * step))
        rate = cubic.deriv()(at) / step
        slopes.velocity[first : first + 4, seen.column(self.grain)] = [-b(at) / rate for b in basis]
        return slopes


@dataclass(frozen=True, eq=False)
class Misfit:
    """Half the sum of squares of the differences from traces at the samples of the scene.

    Parameters
    ----------
    group : sequence of G int
        Grains of which there are traces.
    values : (T, G) array
        One row a sample, m/s or m.
    field : "velocity" or "displacement"
    scale : float
        What differences are divided by: the noise.
    """

    group: Sequence[int]
    values: Array
    field: str = "velocity"
    scale: float = 1.0
    dense = False

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains of the traces."""
        if self.field not in ("velocity", "displacement"):
            raise InputError(
                [("field", f'must be "velocity" or "displacement" (got {shown(self.field)})')]
            )
        if np.shape(self.values) != (scene.samples, len(self.group)):
            wanted = scene.samples, len(self.group)
            raise InputError(
                [
                    (
                        "values",
                        f"must be of shape {wanted}, samples and grains, not {np.shape(self.values)}",
                    )
                ]
            )
        return _known(scene, self.group)

    def __call__(self, seen: Seen) -> Slopes:
        """Return the misfit and its derivatives."""
        difference = (getattr(seen, self.field) - self.values) / self.scale
        slopes = seen.slopes(float((difference**2).sum() / 2))
        getattr(slopes, self.field)[:] = difference / self.scale
        return slopes


@dataclass(frozen=True)
class DriveWork:
    """The work that a driven grain 1 takes, J, beyond that against what balances at rest.

    Its kinetic energy at the end, less that at t = 0, and the force of the contact below it times its velocity, over
    the times looked at by the trapezoidal rule with Gregory's corrections at the ends.
    """

    dense = True

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return grains 1 and 2."""
        if scene.drive is None or scene.drive.grain != 1:
            raise InputError([("objective", "DriveWork needs a scene in which grain 1 is driven")])
        return [1, 2]

    def __call__(self, seen: Seen) -> Slopes:
        """Return the work and its derivatives."""
        force, by_closer, by_force, by_constant, _ = contact_force(seen, 1)
        change, v, m = (
            force - seen.scene.chain.contacts.force[1],
            seen.velocity[:, 0],
            seen.scene.chain.masses[0],
        )
        weight = quadrature(v.size) * seen.time[1]
        slopes = seen.slopes(float(m / 2 * (v[-1] ** 2 - v[0] ** 2) + weight @ (change * v)))
        slopes.displacement[:, 0], slopes.displacement[:, 1] = (
            weight * v * by_closer,
            -weight * v * by_closer,
        )
        slopes.velocity[:, 0] = weight * change
        slopes.velocity[-1, 0] += m * v[-1]
        slopes.velocity[0, 0] -= m * v[0]
        slopes.masses[0] = (v[-1] ** 2 - v[0] ** 2) / 2
        slopes.forces[1], slopes.constants[1] = (
            (weight * v) @ (by_force - 1),
            (weight * v) @ by_constant,
        )
        return slopes


@dataclass(frozen=True, eq=False)
class Function:
    """Any function of the samples that returns its own derivatives.

    Parameters
    ----------
    function : callable
        Takes time (T,) s, displacement (T, G) m and velocity (T, G) m/s, and returns a number and its derivatives by
        displacement and by velocity, of the same shapes.
    group : sequence of G int
    """

    function: Callable[[Array, Array, Array], tuple[float, Array, Array]]
    group: Sequence[int]
    dense: bool = False

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the group."""
        return _known(scene, self.group)

    def __call__(self, seen: Seen) -> Slopes:
        """Return the value and the derivatives that the function gives."""
        value, displacement, velocity = self.function(seen.time, seen.displacement, seen.velocity)
        return seen.slopes(float(value))._replace(displacement=displacement, velocity=velocity)
