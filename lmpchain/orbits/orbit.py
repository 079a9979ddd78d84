"""A periodic orbit: state, energy, Floquet multipliers, stability, and scenes that start on it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import svd

from ..chain.chain import Chain
from ..chain.damping import viscous_force
from ..errors import InputError, shown
from ..scene.excitation import Drive, Force, Profile
from ..scene.scene import Scene
from ..util.arrays import Array, read_only
from ..util.lazy import cached_property
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from ..util.tabular import NamedColumn, Tabular
from . import floquet
from .flow import Flow, Passage
from .shooting import Equations, OrbitPoint, Solution

# Largest |multiplier| - 1 by rounding of a pair on the unit circle.
STABLE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Orbit(Shown, Tabular):
    """A periodic orbit of Eq. (1), returned by `find`, `normal_mode`, `breather` and `follow`.

    Attributes
    ----------
    chain : Chain
    period : float
        Period, s.
    displacement, velocity : (N,) arrays
        State at t = 0, m and m/s.
    drive : Drive, Force or None
        Motion of grain 1 or of the top wall, or force on a grain, with the frequency of the orbit.
    reversible : bool
        Whether all grains rest at t = 0, so that the motion is symmetric in time.
    residual : float
        Largest change of a displacement or velocity over a period, relative to the largest value in
        the orbit; below 1e-12 unless the motion amplifies rounding errors more strongly.
    error : float
        Relative error of the orbit and its period due to the integrator, estimated with half the
        steps. If an orbit can nearly slide along neighbouring orbits, as a strong dark breather
        can, most of the error is a rounding error in this direction, along which the period hardly
        changes.
    iterations : int
        Number of steps of Newton's method.
    """

    chain: Chain
    period: float
    displacement: Array
    velocity: Array
    drive: Drive | Force | None
    reversible: bool
    residual: float
    error: float
    iterations: int
    flow: Flow = field(repr=False)
    mesh: Array = field(repr=False)
    state: Array = field(repr=False)

    @property
    def energy(self) -> float:
        """Energy above rest at t = 0, J; conserved unless the orbit is driven."""
        return float(self.chain.excess_energy(self.displacement, self.velocity))

    @property
    def amplitude(self) -> float:
        """Largest displacement of any grain, m."""
        return float(np.abs(self._passage.displacement).max())

    def response(self, of: str = "amplitude") -> float:
        """Return the size of the motion, m or N.

        Parameters
        ----------
        of : str
            "amplitude" for the largest displacement of any grain; "displacement:GRAIN" or
            "force:CONTACT" for half of the range over a period. Contact n is below grain n.

        Raises
        ------
        InputError
            If `of` is none of these, or the grain or contact does not exist.
        """
        if of == "amplitude":
            return self.amplitude
        kind, _, number = of.partition(":")
        if kind not in ("displacement", "force") or not number.isdecimal():
            cure = '"amplitude", "displacement:GRAIN" or "force:CONTACT"'
            raise InputError.at("of", f"must be {cure} (got {shown(of)})")
        contacts = np.flatnonzero(self.chain.contacts.exists)
        places = contacts if kind == "force" else np.arange(1, self.chain.grains + 1)
        if int(number) not in places:
            what = "contacts" if kind == "force" else "grains"
            fault = f"the {what} are numbered {places[0]} to {places[-1]} (got {shown(of)})"
            raise InputError.at("of", fault)
        if kind == "force":
            return float(np.ptp(self._force_changes()[:, int(number)]) / 2)
        return float(np.ptp(self._passage.displacement[:, int(number) - 1]) / 2)

    @cached_property
    def tangent(self) -> Array:
        """Canonical tangent map (2M, 2M) of a period, or of half a period if reversible."""
        size = 2 * self.flow.size
        steps = self.mesh[: self.mesh.size // 2] if self.reversible else self.mesh
        passage = self.flow.run(self.state, self.period, steps, np.eye(size).reshape(2, -1, size))
        return read_only(passage.deviation.reshape(size, size))

    @cached_property
    def monodromy(self) -> Array:
        """Tangent map of a period, (2M, 2M), in the variables of `orbits.flow`.

        The map is symplectic unless the chain is damped.
        """
        return read_only(floquet.close(self.tangent) if self.reversible else self.tangent)

    @cached_property
    def means(self) -> floquet.Complex:
        """Means (l + 1/l) / 2 of all pairs of multipliers, (M-1,), or (M,) if driven.

        A mean is real and between -1 and 1 if its pair is stable.

        Raises
        ------
        InputError
            If the chain is damped, because its multipliers do not come in pairs.
        """
        if not self.flow.symplectic:
            raise InputError.at(
                "means", "a damped chain has no pairs of multipliers: use `multipliers`"
            )
        means = (floquet.reversible_means if self.reversible else floquet.means)(self.tangent)
        return read_only(means if self.drive is not None else floquet.without_trivial(means))

    @cached_property
    def multipliers(self) -> floquet.Complex:
        """Floquet multipliers, largest first, (2M,) complex.

        Without damping, the multipliers are ordered in pairs l, 1/l. Without a drive, the last pair
        is 1 and belongs to the directions along the orbit and along the family.
        """
        if not self.flow.symplectic:
            return read_only(floquet.all_multipliers(self.monodromy))
        return read_only(floquet.multipliers(self.means, self.drive is None))

    @property
    def stable(self) -> bool:
        """Whether no multiplier is outside the unit circle."""
        return bool((np.abs(self.multipliers) < 1 + STABLE).all())

    @property
    def unstable(self) -> floquet.Complex:
        """Multipliers outside the unit circle, largest first."""
        return self.multipliers[np.abs(self.multipliers) >= 1 + STABLE]

    @cached_property
    def _passage(self) -> Passage:
        """The motion over a period."""
        return self.flow.run(self.state, self.period, self.mesh)

    def motion(self) -> tuple[Array, Array, Array]:
        """Return times (K+1,) s, displacement and velocity (K+1, N) at the steps of a period."""
        time = np.concatenate(([0.0], np.cumsum(self.mesh))) * self.period
        return time, self._passage.displacement, self._passage.velocity

    def forces(self) -> Array:
        """Return the forces of all contacts at the steps of a period, (K+1, N+1) N.

        Contact n is below grain n, and contact 0 above grain 1. Viscous forces are included.
        """
        contacts = self.chain.contacts
        closer = contacts.closer(self._passage.displacement, self._passage.wall[0])
        elastic = contacts.force_at(np.maximum(contacts.overlap + closer, 0.0))
        return np.asarray(elastic + self._viscous_forces())

    def _force_changes(self) -> Array:
        """Return the forces minus the forces at rest, accurate also for weak motion."""
        contacts = self.chain.contacts
        closer = contacts.closer(self._passage.displacement, self._passage.wall[0])
        return contacts.force_change(closer) + self._viscous_forces()

    def _viscous_forces(self) -> Array:
        contacts = self.chain.contacts
        passage = self._passage
        overlap = contacts.overlap + contacts.closer(passage.displacement, passage.wall[0])
        closing = contacts.closer(passage.velocity, passage.wall[1])
        return viscous_force(contacts, self.chain.contact_viscosity, overlap, closing)

    def direction(self, number: int = 1) -> tuple[Array, Array]:
        """Return the displacement and velocity (N,) of an unstable Floquet direction.

        The largest displacement is scaled to 1 m. For a complex multiplier the real part is
        returned, which rotates as it grows.

        Parameters
        ----------
        number : int
            Number of the direction, from 1 for the fastest growth.

        Raises
        ------
        InputError
            If the orbit has fewer unstable directions.
        """
        growing = self.unstable
        if not 1 <= number <= growing.size:
            many = f"has {growing.size} unstable directions" if growing.size else "is stable"
            raise InputError.at(
                "number", f"the orbit {many}: there is no direction {shown(number)}"
            )
        shifted = self.monodromy - growing[number - 1] * np.eye(len(self.monodromy))
        vector = svd(shifted)[2][-1].conj()
        # The phase of a complex direction is arbitrary; the largest component is made real.
        vector = vector * np.exp(-1j * np.angle(vector[np.abs(vector).argmax()]))
        u, v = self.flow.deviation(self.state, vector.real.reshape(2, -1))
        return u / np.abs(u).max(), v / np.abs(u).max()

    def perturbed(self, size: float, number: int = 1) -> Profile | Drive | Force:
        """Return the orbit plus an unstable direction, as the initial state of a run.

        Parameters
        ----------
        size : float
            Largest displacement of the perturbation relative to the amplitude of the orbit.
        number : int
            Number of the direction, from 1 for the fastest growth.
        """
        u, v = self.direction(number)
        scale = size * self.amplitude
        return self._excitation(self.displacement + scale * u, self.velocity + scale * v)

    def _excitation(self, u: Array, v: Array) -> Profile | Drive | Force:
        """Return the excitation that starts from a state, (N,) m and m/s, with the drive if any."""
        if self.drive is None:
            return Profile(displacement=u, velocity=v)
        free = np.arange(u.size) >= self.flow.held
        return self.drive.replace(start=Profile(displacement=u * free, velocity=v * free))

    def scene(self, periods: float = 1, samples: int = 101) -> Scene:
        """Return the scene that runs the orbit for a number of periods in any engine."""
        excitation = self._excitation(self.displacement, self.velocity)
        return Scene(
            chain=self.chain, excitation=excitation, duration=periods * self.period, samples=samples
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacements at five times of half a period, and return the axes."""
        from matplotlib import colormaps
        from matplotlib.ticker import MaxNLocator

        ax = chart(ax, "grain", "displacement [m]")
        time, u, _ = self.motion()
        for number, label in enumerate(("at t = 0", "T/8", "T/4", "3T/8", "T/2")):
            row = u[np.abs(time - number / 8 * self.period).argmin()]
            colour = colormaps["viridis"](number / 4.5)
            ax.plot(np.arange(1, row.size + 1), row, ".-", lw=1, color=colour, label=label)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        return finish(ax, loc="upper left", bbox_to_anchor=(1.0, 1.0))

    def to_json(self) -> dict[str, Any]:
        """Return the numbers of the orbit."""
        return {
            "period_s": self.period,
            "frequency_hz": 1 / self.period,
            "energy_J": self.energy,
            "amplitude_m": self.amplitude,
            "residual": self.residual,
            "error": self.error,
            "stable": self.stable,
            "multipliers": [[z.real, z.imag] for z in self.multipliers.tolist()],
            "displacement_m": self.displacement.tolist(),
            "velocity_m_per_s": self.velocity.tolist(),
        }

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("grain", "", np.arange(1, self.chain.grains + 1))
        yield NamedColumn("displacement", "m", self.displacement)
        yield NamedColumn("velocity", "m/s", self.velocity)


def orbit_of(equations: Equations, solution: Solution, error: float) -> Orbit:
    """Return the orbit of a solution of Newton's method."""
    point: OrbitPoint = solution.point
    flow = equations.flow_at(point.value)
    passage = flow.run(point.state, point.period, solution.mesh)
    u = passage.displacement
    v = passage.velocity
    drive = None if flow.drive is None else flow.drive.replace(frequency=flow.cycles / point.period)
    return Orbit(
        chain=flow.chain,
        period=point.period,
        displacement=read_only(u[0].copy()),
        velocity=read_only(v[0].copy()),
        drive=drive,
        reversible=equations.reversible,
        residual=max(float(np.abs(x[-1] - x[0]).max() / np.abs(x).max()) for x in (u, v)),
        error=error,
        iterations=solution.iterations,
        flow=flow,
        mesh=solution.mesh,
        state=point.state,
    )
