"""The interface of an excitation, on which engines and measures depend."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import Field

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.validation import Checked, Whole
from .waveform import Waveform

Number = Annotated[Whole, Field(ge=1)]


class Push(NamedTuple):
    """The external force on a grain or on the top wall, minus its value at rest.

    Attributes
    ----------
    force : (T,) array
        The force, N. The inertial force of a driven grain, mass times acceleration, is not
        included.
    rate : (T,) array
        Time derivative of `force`, N/s.
    speed : (T,) array
        Velocity of the grain or wall, m/s.
    acceleration : (T,) array
        Acceleration of the grain or wall, m/s2.
    inertia : float
        Mass of the grain if it is driven, kg; otherwise 0.
    on_grain : bool
        Whether the force acts on a grain. Otherwise it acts on a wall, and the contact of the wall
        transmits it to the chain.
    """

    force: Array
    rate: Array
    speed: Array
    acceleration: Array
    inertia: float
    on_grain: bool


class Excitation(Checked):
    """The cause of the motion of a chain.

    The default methods describe an excitation at t = 0, after which no external force acts on the
    chain. Excitations that act later override them.

    Attributes
    ----------
    kind : str
        Name of the excitation in scene files.
    strength : tuple of str
        Names of the fields to which the motion of a linear chain is proportional. Messages about
        an excitation that is too strong name the first one.
    does_work : bool
        Whether the excitation acts after t = 0, so that the energy of the chain is not known
        beforehand.
    of_chain : bool
        Whether the imposed motion also depends on the masses and contacts of the chain.
    """

    kind: ClassVar[str]
    strength: ClassVar[tuple[str, ...]]
    does_work: ClassVar[bool] = False
    of_chain: ClassVar[bool] = False

    @property
    def driven(self) -> int:
        """Number of grains, from the top, with a prescribed motion."""
        return 0

    @property
    def from_below(self) -> bool:
        """Whether the motion of the bottom wall or of the held last grain is prescribed."""
        return False

    @property
    def acts_on(self) -> int:
        """Number of the grain that is driven or forced after t = 0; 0 without such a grain."""
        return 0

    @property
    def waveform(self) -> Waveform | None:
        """Motion of the driven grain or wall, m, or a force, N, after t = 0; or None."""
        return None

    @property
    def wall(self) -> Waveform | None:
        """Motion of the top wall, m; None if the wall does not move."""
        return None

    def smooth_until(self, duration: float) -> bool:
        """Return whether the third derivative jumps only at ends of steps, up to a time, s."""
        return self.waveform is None or self.waveform.smooth_until(duration)

    @property
    def kink_spacing(self) -> float:
        """Smallest time between kinks, where adaptive steps end, s; infinite without kinks."""
        return np.inf if self.waveform is None else self.waveform.kink_spacing

    @property
    def fastest(self) -> float:
        """Highest frequency that a step must resolve, rad/s."""
        return 0.0 if self.waveform is None else self.waveform.fastest

    @property
    def linear(self) -> bool:
        """Whether engines of the linearised chain can solve it; true except for a spline."""
        return self.waveform is None or self.waveform.spline is None

    @property
    def strike_velocity(self) -> float:
        """Velocity given to one grain at t = 0, m/s; 0 for other excitations."""
        return 0.0

    @property
    def strikes_top(self) -> bool:
        """Whether the excitation is a velocity of grain 1 at t = 0."""
        return False

    @property
    def label(self) -> str:
        """Name of the excitation in the title of a picture."""
        return f"a {self.kind}"

    @abstractmethod
    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement (N,) m and velocity (N,) m/s at t = 0, positive downward."""

    @abstractmethod
    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield the key and message of each fault for this chain and duration, s."""

    def largest(self, chain: Chain) -> tuple[Array, Array]:
        """Return the largest imposed displacement (N,) m and velocity (N,) m/s."""
        return self.initial(chain)

    def strongest(self, chain: Chain, duration: float) -> tuple[float, float]:
        """Return the largest imposed displacement and speed of any grain within a time, m, m/s."""
        displacement, velocity = self.largest(chain)
        return float(np.abs(displacement).max()), float(np.abs(velocity).max())

    def energy(self, chain: Chain) -> float:
        """Return the energy above rest at t = 0, J; infinite if the excitation does work later."""
        return np.inf if self.does_work else float(chain.excess_energy(*self.initial(chain)))

    @abstractmethod
    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that is moved directly."""

    @abstractmethod
    def part(self, first: int, last: int) -> Excitation:
        """Return the excitation of `Chain.part(first, last)`, which includes all excited grains."""

    def scaled(self, factor: float) -> Self:
        """Return the excitation multiplied by a factor."""
        fields = self.given()
        return self.replace(**{key: factor * fields[key] for key in self.strength if key in fields})

    def energy_norm(self, chain: Chain, duration: float) -> float:
        """Return an upper bound on sqrt(2 E), J^(1/2), for the energy E at t = 0."""
        u, v = self.initial(chain)
        contacts = chain.contacts
        kinetic = (chain.masses * v**2).sum()
        elastic = (contacts.stiffness * contacts.closer(u) ** 2).sum()
        if chain.ground is not None:
            elastic += (chain.ground_stiffness * u**2).sum()
        return float(np.sqrt(kinetic + elastic))

    def push(
        self, chain: Chain, time: Array, force: Array, rate: Array, velocity: Array
    ) -> Push | None:
        """Return the external force at these times, (T,) s; None if nothing acts after t = 0.

        Parameters
        ----------
        chain : Chain
            The chain that is excited.
        time : (T,) array
            Times, s.
        force : (T, N+1) array
            Force of every contact minus its force at rest, N.
        rate : (T, N+1) array
            Time derivative of `force`, N/s.
        velocity : (T, N) array
            Velocity of every grain, m/s.
        """
        return None


class OneGrain(Excitation):
    """An excitation of one grain, with its number as a field."""

    grain: Number

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if the chain has no such grain, or if this grain is held."""
        if self.grain > chain.grains:
            yield "grain", f"there is no grain {self.grain}: the chain has {chain.grains}"
        elif self.grain > chain.movable:
            yield "grain", f"grain {self.grain} is held; choose one of 1 to {chain.movable}"

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last excited grain, which are both `grain`."""
        return self.grain, self.grain

    def part(self, first: int, last: int) -> Excitation:
        """Return the excitation with the grain renumbered within grains first ... last."""
        return self if first == 1 else self.replace(grain=self.grain - first + 1)

    def at_grain(self, chain: Chain, value: float) -> Array:
        """Return an (N,) array with this value for the grain, and 0 for the others."""
        array = np.zeros(chain.grains)
        array[self.grain - 1] = value
        return array
