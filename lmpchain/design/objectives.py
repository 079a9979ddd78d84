"""Objectives: scalar functions of a motion and the chain, with their derivatives.

An objective uses the motion of some grains at equally spaced times. By default these are the
samples of the scene. A `dense` objective uses so many times that the fastest motion turns by at
most a quarter of a radian between them, and twice as many whenever the steps of a gradient are
halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..chain import ground
from ..chain.contact_law import Contacts
from ..errors import InputError, shown
from ..scene.scene import Scene
from ..util.arrays import Array, numbers, whole_numbers


class Seen(NamedTuple):
    """The motion of some grains at the times of an objective.

    Attributes
    ----------
    scene : Scene
    time : (T,) array
        Times, s.
    grains : (G,) array
        Grain numbers, from 1.
    displacement, velocity : (T, G) arrays
        Displacement, positive downward, m; velocity, m/s.
    """

    scene: Scene
    time: Array
    grains: np.ndarray
    displacement: Array
    velocity: Array

    def slopes(self, value: float) -> Slopes:
        """Return a value with derivatives of 0, for the caller to fill in."""
        chain = self.scene.chain
        contacts = np.zeros((3, chain.grains + 1))
        motion = (np.zeros(self.displacement.shape), np.zeros(self.velocity.shape))
        return Slopes(value, *motion, np.zeros(chain.grains), *contacts)

    def column(self, grain: int) -> int:
        """Return the column of a grain."""
        return int(np.flatnonzero(self.grains == grain)[0])

    def columns(self, group: ArrayLike) -> list[int]:
        """Return the columns of several grains, in the order of the group."""
        return [self.column(grain) for grain in np.atleast_1d(group)]


class Slopes(NamedTuple):
    """A value and its derivatives.

    Attributes
    ----------
    value : float
        Value of the objective.
    displacement, velocity : (T, G) arrays
        Derivative with respect to the displacement; derivative with respect to the velocity.
    masses, constants, forces, viscosity : (N,) and (N+1,) arrays
        Derivatives with respect to the masses, and to the constants, forces at rest and viscosities
        of contacts, if the objective depends on them directly.
    """

    value: float
    displacement: Array
    velocity: Array
    masses: Array
    constants: Array
    forces: Array
    viscosity: Array


class ContactForce(NamedTuple):
    """The force of a contact, its viscous part included, and its derivatives.

    Attributes
    ----------
    value : (T,) array
        Force, N.
    by_closer, by_closing : (T,) arrays
        Derivative with respect to the approach of the two bodies, N/m; derivative with respect to
        the rate of approach, N s/m.
    by_force, by_constant, by_viscosity : (T,) arrays
        Derivative with respect to the force at rest; derivative with respect to the contact
        constant, m^delta; derivative with respect to the viscosity, N/s.
    grains : list of int
        One or two grains of the contact.
    """

    value: Array
    by_closer: Array
    by_closing: Array
    by_force: Array
    by_constant: Array
    by_viscosity: Array
    grains: list[int]


def contact_force(view: Seen, contact: int) -> ContactForce:
    """Return the force of a contact and its derivatives.

    With a law by formula, the derivatives with respect to the force at rest and to the contact
    constant are NaN.
    """
    chain = view.scene.chain
    law = chain.contacts.of(contact)
    delta = chain.law.power
    grains = [grain for grain in (contact, contact + 1) if 1 <= grain <= chain.grains]
    viscosity = chain.contact_viscosity[contact]
    closer = np.zeros(view.time.size)
    closing = np.zeros(view.time.size)
    for grain in grains:
        sign = 1 if grain == contact else -1
        closer += view.displacement[:, view.column(grain)] * sign
        closing += view.velocity[:, view.column(grain)] * sign
    if delta is None:
        return _by_formula(law, viscosity, closer, closing, grains)
    overlap = np.maximum(law.overlap + closer, 0.0)
    stiffness = law.stiffness_at(overlap) * (overlap > 0)
    viscous = viscosity * stiffness * closing
    # The viscous force grows with the overlap, because its stiffness does.
    growth = np.zeros(closer.shape)
    if viscosity > 0:
        np.divide((delta - 1) * viscous, overlap, out=growth, where=overlap > 0)
    by_closer = stiffness + growth
    by_force = np.zeros(closer.shape)
    by_constant = overlap**delta + viscous / law.constant
    if law.force > 0:
        # The overlap at rest is (F / K)^(1/delta).
        by_force = by_closer * law.overlap / (delta * law.force)
        by_constant = by_constant - by_closer * law.overlap / (delta * law.constant)
    return ContactForce(
        value=law.force_at(overlap) + viscous,
        by_closer=by_closer,
        by_closing=viscosity * stiffness,
        by_force=by_force,
        by_constant=by_constant,
        by_viscosity=stiffness * closing,
        grains=grains,
    )


def _by_formula(
    law: Contacts, viscosity: float, closer: Array, closing: Array, grains: list[int]
) -> ContactForce:
    """Return the force of a contact with a law by formula, and its derivatives by the motion."""
    overlap = law.overlap + closer
    stiffness = law.stiffness_at(overlap)
    growth = np.zeros(closer.shape)
    if viscosity > 0:
        # An open contact that pulls has a viscous force, too.
        growth = viscosity * law.law.curvature(overlap, law.constant) * closing
    unknown = np.full(closer.shape, np.nan)
    return ContactForce(
        value=law.force + law.force_change(closer) + viscosity * stiffness * closing,
        by_closer=stiffness + growth,
        by_closing=viscosity * stiffness,
        by_force=unknown,
        by_constant=unknown,
        by_viscosity=stiffness * closing,
        grains=grains,
    )


def quadrature(size: int) -> Array:
    """Return the weights (size,) of the trapezoidal rule with Gregory's corrections of order 6."""
    weight = np.ones(size)
    weight[[0, -1]] = 0.5
    # Backward differences are applied at both ends, up to an order at which they do not overlap.
    for k, gregory in enumerate((1 / 12, 1 / 24, 19 / 720, 3 / 160, 863 / 60480), 1):
        if 2 * k < size:
            # The k-th difference has alternating binomial coefficients.
            change = [gregory * (-1) ** j * math.comb(k, j) for j in range(k + 1)]
            weight[: k + 1] -= change
            weight[-k - 1 :] -= change[::-1]
    return weight


class Objective(Protocol):
    """A scalar function of a motion and the chain, with its derivatives."""

    @property
    def dense(self) -> bool:
        """Whether the value also depends on the motion between samples."""

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains that the value depends on; raise `InputError` if they do not exist."""

    def __call__(self, view: Seen) -> Slopes:
        """Return the value and its derivatives."""


def check_objective(objective: object, key: str = "objective") -> None:
    """Raise `InputError` unless the argument is an objective."""
    has_all = all(hasattr(objective, name) for name in ("dense", "grains"))
    if isinstance(objective, type) or not has_all or not callable(objective):
        message = f"must be an objective, such as PeakForce(40) (got {shown(objective)})"
        raise InputError.at(key, message)


AHEAD = 1e-100  # Speed of a grain far ahead of a wave, m/s.


def _check_grains(scene: Scene, group: ArrayLike) -> list[int]:
    """Return the grains of a group, and raise `InputError` if the scene lacks one of them."""
    last = scene.chain.grains
    grains: list[int] = np.atleast_1d(whole_numbers(group, "grains")).tolist()
    if not grains or min(grains) < 1 or max(grains) > last:
        raise InputError.at("grains", f"must be some of 1 to {last} (got {shown(grains)})")
    return grains


def _finite(key: str, value: object) -> float:
    """Return a finite number, and raise `InputError` for other values."""
    number = numbers(value, key)
    if number.ndim or not np.isfinite(number):
        raise InputError.at(key, f"must be a finite number (got {shown(value)})")
    return float(number)


def _check_still(scene: Scene, contact: int) -> None:
    """Raise `InputError` if this contact is with a moving wall."""
    if contact == 0 and scene.excitation.wall is not None:
        message = "cannot depend on the contact with a moving wall: use other grains"
        raise InputError.at("objective", message)


@dataclass(frozen=True)
class PeakForce:
    """The peak force at a contact, N, including the force at rest: a smooth maximum over time.

    The value is the mean of the force F over time with weights F^sharpness. It is below the peak by
    a fraction of about 1 / (2 sharpness), which is 0.5 % for a sharpness of 100.

    Parameters
    ----------
    contact : int
        Number n of the contact below grain n; 0 is the contact with the top wall, and N the contact
        with the bottom wall.
    sharpness : float
        Exponent of the weights.
    """

    contact: int
    sharpness: float = 100.0
    dense = True

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains at either end of the contact."""
        existing = np.flatnonzero(scene.chain.contacts.exists).tolist()
        whole = isinstance(self.contact, int | np.integer) and not isinstance(self.contact, bool)
        if not whole or self.contact not in existing:
            message = f"must be one of {existing[0]} to {existing[-1]} (got {shown(self.contact)})"
            raise InputError.at("contact", message)
        _check_still(scene, self.contact)
        if _finite("sharpness", self.sharpness) <= 0:
            raise InputError.at("sharpness", f"must be above 0 (got {shown(self.sharpness)})")
        ends = (self.contact, self.contact + 1)
        return [grain for grain in ends if 1 <= grain <= scene.chain.grains]

    def __call__(self, view: Seen) -> Slopes:
        """Return the smooth maximum and its derivatives."""
        force = contact_force(view, self.contact)
        largest = force.value.max()
        # If the contact stays open, all derivatives are 0.
        if largest <= 0:
            return view.slopes(0.0)
        # A viscous contact pulls before it opens; negative forces are excluded from the maximum.
        share = np.maximum(force.value, 0.0) / largest
        weight = quadrature(share.size) * share**self.sharpness
        weight /= weight.sum()
        value = float(largest * (weight @ share))
        # Weights of small forces vanish, so their ratio may be set to 0.
        ratio = np.divide(value, force.value, out=np.zeros(share.size), where=share > 1e-3)
        slope = weight * (1 + self.sharpness * (1 - ratio))
        slopes = view.slopes(value)
        for grain in force.grains:
            sign = 1 if grain == self.contact else -1
            slopes.displacement[:, view.column(grain)] = slope * force.by_closer * sign
            slopes.velocity[:, view.column(grain)] = slope * force.by_closing * sign
        slopes.forces[self.contact] = slope @ force.by_force
        slopes.constants[self.contact] = slope @ force.by_constant
        slopes.viscosity[self.contact] = slope @ force.by_viscosity
        return slopes


@dataclass(frozen=True)
class _AtTime:
    """A sum over a group of grains at one sample.

    Parameters
    ----------
    group : sequence of int
        Numbers of the grains.
    time : float, optional
        Time of the sample, s; by default the end. The nearest sample is used.
    """

    group: Sequence[int]
    time: float | None = None
    dense = False

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains whose motion determines the value."""
        if self.time is not None and not 0 <= _finite("time", self.time) <= scene.duration:
            message = f"must be from 0 to {scene.duration:g} s (got {shown(self.time)})"
            raise InputError.at("time", message)
        return _check_grains(scene, self.group)

    def _look(self, view: Seen) -> int:
        return -1 if self.time is None else int(np.abs(view.time - self.time).argmin())


class KineticEnergy(_AtTime):
    """The kinetic energy of a group of grains at one sample, J."""

    def __call__(self, view: Seen) -> Slopes:
        """Return the energy and its derivatives."""
        look = self._look(view)
        m = view.scene.chain.masses[view.grains - 1]
        v = view.velocity[look]
        slopes = view.slopes(float(m @ v**2 / 2))
        slopes.velocity[look] = m * v
        slopes.masses[view.grains - 1] = v**2 / 2
        return slopes


class Energy(_AtTime):
    """The energy of a group of grains above rest at one sample, J.

    The energy is divided among the grains as in `measure.energy.shares`. A grain has its kinetic
    energy, half of the energy of each contact with another grain, and the whole energy of contacts
    with walls and with the ground. The work of load and weight on a contact is subtracted from its
    energy.
    """

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the group and its neighbours."""
        group = super().grains(scene)
        scene.chain.refuse_moving_ground("the energy of grains")
        _check_still(scene, 0 if 1 in group else 1)
        # The energy of a contact depends on both of its grains.
        near = {other for grain in group for other in (grain - 1, grain, grain + 1)}
        return sorted(near & set(range(1, scene.chain.grains + 1)))

    def __call__(self, view: Seen) -> Slopes:
        """Return the energy and its derivatives."""
        look = self._look(view)
        chain = view.scene.chain
        contacts = chain.contacts
        at = view.grains - 1
        inside = np.isin(view.grains, self.group)
        m = np.where(inside, chain.masses[at], 0.0)
        v = view.velocity[look]
        u = np.zeros(chain.grains)
        u[at] = view.displacement[look]
        # Each grain of a contact has half of its energy; a wall contact belongs entirely to its
        # grain.
        share = np.zeros(chain.grains + 1)
        np.add.at(share, at, inside / 2)
        np.add.at(share, at + 1, inside / 2)
        share[[0, -1]] *= 2
        closer = contacts.closer(u)
        energy = share * contacts.energy(closer)
        change = share * contacts.force_change(closer)
        # This is the derivative with respect to -log(K) at a fixed force at rest; that of a formula
        # is another one.
        delta = chain.law.power or np.nan
        softer = np.where(contacts.pressed, (energy - closer * change) / delta, -energy)
        slopes = view.slopes(float(m @ v**2 / 2 + energy.sum()))
        slopes.displacement[look] = np.diff(change)[at]
        if chain.ground is not None:
            # With a ground, derivatives are differences of values.
            owned = np.isin(np.arange(chain.grains) + 1, self.group)
            slopes = slopes._replace(
                value=slopes.value + float(owned @ ground.energy(chain.ground, u))
            )
        slopes.velocity[look] = m * v
        slopes.masses[at] = inside * v**2 / 2
        slopes.constants[:] = -softer / np.where(contacts.exists, contacts.constant, 1.0)
        rest = np.where(contacts.pressed, contacts.force, 1.0)
        slopes.forces[:] = np.where(contacts.pressed, energy + softer, 0.0) / rest
        return slopes


class Momentum(_AtTime):
    """The momentum of a group of grains at one sample, kg m/s, positive downward."""

    def __call__(self, view: Seen) -> Slopes:
        """Return the momentum and its derivatives."""
        look = self._look(view)
        m = view.scene.chain.masses[view.grains - 1]
        v = view.velocity[look]
        slopes = view.slopes(float(m @ v))
        slopes.velocity[look] = m
        slopes.masses[view.grains - 1] = v
        return slopes


@dataclass(frozen=True)
class ArrivalTime:
    """The time at which the speed of a grain first reaches a threshold, s.

    Between the evaluation times, the velocity is interpolated by a cubic through the four nearest
    values.

    Parameters
    ----------
    grain : int
        Number of the grain.
    velocity : float
        Threshold, m/s; negative for an upward motion.
    """

    grain: int
    velocity: float
    dense = True

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grain."""
        _finite("velocity", self.velocity)
        return _check_grains(scene, [self.grain])

    def __call__(self, view: Seen) -> Slopes:
        """Return the time and its derivatives; raise `InputError` if the grain is too slow."""
        from scipy.optimize import brentq

        v = view.velocity[:, view.column(self.grain)]
        above = np.flatnonzero(np.sign(self.velocity) * v >= abs(self.velocity))
        if not above.size or above[0] == 0:
            reason = f"is never faster than {np.abs(v).max():.3g} m/s: use another threshold"
            if above.size:
                reason = "has that velocity at t = 0: use another threshold"
            elif np.abs(v).max() < AHEAD:
                reason = "is not reached by any wave: use a longer duration"
            raise InputError.at("velocity", f"grain {self.grain} {reason}")
        # The crossing is between the second and the third time, except at the ends.
        first = int(np.clip(above[0] - 2, 0, v.size - 4))
        near = v[first : first + 4]
        step = view.time[1]
        nodes = np.arange(4.0)
        # Lagrange polynomials of the four nearest times.
        basis = []
        for k in range(4):
            others = np.delete(nodes, k)
            basis.append(np.poly1d(np.poly(others) / np.prod(k - others)))
        cubic = sum((b * value for b, value in zip(basis, near, strict=True)), np.poly1d([0.0]))
        end = above[0] - first
        at = brentq(lambda t: cubic(t) - self.velocity, end - 1, end, xtol=1e-14)
        slopes = view.slopes(float((first + at) * step))
        # A larger velocity near the crossing makes the crossing earlier.
        rate = cubic.deriv()(at) / step
        slopes.velocity[first : first + 4, view.column(self.grain)] = [-b(at) / rate for b in basis]
        return slopes


@dataclass(frozen=True, eq=False)
class Misfit:
    """Half the sum of squared differences from measured traces at the samples of the scene.

    Parameters
    ----------
    group : sequence of G int
        Grains with measured traces, in the order of the traces.
    values : (T, G) array
        Measured values, m/s or m, with one row for each sample.
    field : "velocity" or "displacement"
        Measured quantity.
    scale : float
        Noise by which the differences are divided.
    """

    group: Sequence[int]
    values: Array
    field: str = "velocity"
    scale: float = 1.0
    dense = False

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains of the traces."""
        if self.field not in ("velocity", "displacement"):
            message = f'must be "velocity" or "displacement" (got {shown(self.field)})'
            raise InputError.at("field", message)
        grains = _check_grains(scene, self.group)
        shape = scene.samples, len(grains)
        values = numbers(self.values, "values")
        if values.shape != shape:
            message = f"must be of shape {shape}, samples and grains, not {values.shape}"
            raise InputError.at("values", message)
        if not np.isfinite(values).all():
            raise InputError.at("values", "must be finite")
        if _finite("scale", self.scale) <= 0:
            raise InputError.at("scale", f"must be above 0 (got {shown(self.scale)})")
        return grains

    def __call__(self, view: Seen) -> Slopes:
        """Return the misfit and its derivatives."""
        columns = view.columns(self.group)
        difference = (getattr(view, self.field)[:, columns] - self.values) / self.scale
        slopes = view.slopes(float((difference**2).sum() / 2))
        # Several traces may belong to one grain.
        np.add.at(getattr(slopes, self.field).T, columns, difference.T / self.scale)
        return slopes


@dataclass(frozen=True)
class DriveWork:
    """The work done by the drive of grain 1, J, in addition to the work against forces at rest.

    The work is the increase of the kinetic energy of grain 1, plus the time integral of its
    velocity times the force of the contact below it, minus that of a contact with a top wall. The
    integral is computed by the trapezoidal rule with Gregory's corrections at both ends.
    """

    dense = True

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return grains 1 and 2."""
        if scene.drive is None or not scene.drive.driven:
            message = "DriveWork needs a scene in which grain 1 is driven"
            raise InputError.at("objective", message)
        return [1, 2]

    def __call__(self, view: Seen) -> Slopes:
        """Return the work and its derivatives."""
        contacts = view.scene.chain.contacts
        m = view.scene.chain.masses[0]
        v = view.velocity[:, 0]
        weight = quadrature(v.size) * view.time[1]
        value = float(m / 2 * (v[-1] ** 2 - v[0] ** 2))
        slopes = view.slopes(value)
        slopes.velocity[-1, 0] += m * v[-1]
        slopes.velocity[0, 0] -= m * v[0]
        slopes.masses[0] = (v[-1] ** 2 - v[0] ** 2) / 2
        # The contact below pushes grain 1 up, and a top wall pushes it down.
        for contact in (1, 0) if contacts.exists[0] else (1,):
            upward = 1 if contact == 1 else -1
            force = contact_force(view, contact)
            # A sum over times has no derivative, because viscous forces open with a vertical
            # tangent.
            if view.scene.chain.contact_viscosity[contact] > 0 and not force.by_closing.all():
                message = "DriveWork needs a viscous contact that stays closed: press it more, or"
                raise InputError.at("objective", f"{message} use the Energy of grains")
            path = upward * weight * v
            change = force.value - contacts.force[contact]
            value += float(path @ change)
            slopes.velocity[:, 0] += upward * weight * change
            for grain in force.grains:
                sign = 1 if grain == contact else -1
                slopes.displacement[:, grain - 1] += sign * path * force.by_closer
                slopes.velocity[:, grain - 1] += sign * path * force.by_closing
            slopes.forces[contact] = path @ (force.by_force - (contacts.force[contact] > 0))
            slopes.constants[contact] = path @ force.by_constant
            slopes.viscosity[contact] = path @ force.by_viscosity
        slopes = slopes._replace(value=value)
        law = view.scene.chain.ground
        if law is not None:
            # The drive also pushes grain 1 against the ground.
            own = law.of(0)
            u = view.displacement[:, 0]
            pull = own.force(u, view.time)
            slopes = slopes._replace(value=slopes.value + float(weight @ (pull * v)))
            slopes.displacement[:, 0] += weight * v * own.stiffness(u, view.time)
            slopes.velocity[:, 0] += weight * pull
        return slopes


@dataclass(frozen=True, eq=False)
class Function:
    """An arbitrary function of the samples that returns its own derivatives.

    Parameters
    ----------
    function : callable
        Function of time, (T,) s, displacement, (T, G) m, and velocity, (T, G) m/s. It returns a
        number and its derivatives with respect to displacement and velocity, (T, G) each.
    group : sequence of G int
        Numbers of the grains that the function uses, in the order of the columns.
    dense : bool
        Whether the function needs evaluation times between the samples.
    """

    function: Callable[[Array, Array, Array], tuple[float, Array, Array]]
    group: Sequence[int]
    dense: bool = False

    def grains(self, scene: Scene) -> Sequence[int]:
        """Return the grains whose motion determines the value."""
        if not callable(self.function):
            message = f"must contain a function (got {shown(self.function)})"
            raise InputError.at("objective", message)
        return _check_grains(scene, self.group)

    def __call__(self, view: Seen) -> Slopes:
        """Return the value and the derivatives that the user's function computes.

        Raises
        ------
        InputError
            If the function does not return a number and two arrays.
        """
        columns = view.columns(self.group)
        motion = view.displacement[:, columns], view.velocity[:, columns]
        answer = self.function(view.time, *motion)
        shape = motion[0].shape
        shapes = [np.shape(part) for part in answer] if isinstance(answer, tuple) else []
        if shapes != [(), shape, shape]:
            message = f"its function must return a number and two arrays of shape {shape}"
            raise InputError.at("objective", message)
        value, *derivatives = (numbers(part, "objective") for part in answer)
        slopes = view.slopes(float(value))
        for slope, derivative in zip(slopes[1:3], derivatives, strict=True):
            np.add.at(slope.T, columns, derivative.T)
        return slopes
