"""Properties of every excitation, so that nothing else needs to know which one it is."""

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
    """The force of the outside world on a grain or the top wall, beyond what balances at rest.

    Attributes
    ----------
    force, rate : (T,) arrays
        N and N/s; without what the inertia of a driven grain takes, its mass times the
        acceleration.
    speed, acceleration : (T,) arrays
        Of the body, m/s and m/s2.
    inertia : float
        Mass of the grain if it is driven, kg, else 0.
    on_grain : bool
        Whether it acts on a grain, else on the wall, which hands it on by its contact.
    """

    force: Array
    rate: Array
    speed: Array
    acceleration: Array
    inertia: float
    on_grain: bool


class Excitation(Checked):
    """How the chain is set in motion.

    What stands here holds for initial data, after which nothing acts on the chain; others override
    it.

    Attributes
    ----------
    kind : str
        Its name in scene files.
    strength : tuple of str
        Fields that the motion of a linear chain is proportional to, the first of them the one to
        blame if too strong.
    does_work : bool
        Whether it acts after t = 0, so that the energy of the chain is not known beforehand.
    of_chain : bool
        Whether the motion that it imposes follows from masses and contacts of the chain, too.
    """

    kind: ClassVar[str]
    strength: ClassVar[tuple[str, ...]]
    does_work: ClassVar[bool] = False
    of_chain: ClassVar[bool] = False

    @property
    def driven(self) -> int:
        """Number of grains, from the top, whose motion it prescribes."""
        return 0

    @property
    def acts_on(self) -> int:
        """Number of the grain that it moves or pushes after t = 0; 0 for the top wall, or none."""
        return 0

    @property
    def waveform(self) -> Waveform | None:
        """Course after t = 0 of the motion of grain 1 or of the top wall, m, or of a force, N."""
        return None

    @property
    def wall(self) -> Waveform | None:
        """Motion of the top wall, m; None if it stands still."""
        return None

    def smooth_until(self, duration: float) -> bool:
        """Return whether its third derivative jumps up to a time, s, only where a step can end."""
        return self.waveform is None or self.waveform.smooth_until(duration)

    @property
    def corner_spacing(self) -> float:
        """Least time between corners, at which adaptive steps end, s; infinite if it has none."""
        return np.inf if self.waveform is None else self.waveform.corner_spacing

    @property
    def fastest(self) -> float:
        """Highest frequency that a step must resolve, rad/s."""
        return 0.0 if self.waveform is None else self.waveform.fastest

    @property
    def linear(self) -> bool:
        """Whether engines of the linearised chain know its solution: all but that of a spline."""
        return self.waveform is None or self.waveform.spline is None

    @property
    def strike_velocity(self) -> float:
        """Velocity given to one grain at t = 0, m/s; 0 if it is anything else."""
        return 0.0

    @property
    def strikes_top(self) -> bool:
        """Whether it is a velocity given to grain 1."""
        return False

    @property
    def label(self) -> str:
        """Name in the title of a picture."""
        return f"a {self.kind}"

    @abstractmethod
    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement (N,) m and velocity (N,) m/s at t = 0, positive downward."""

    @abstractmethod
    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield the faults, key and message, that it has on this chain for so long, s."""

    def largest(self, chain: Chain) -> tuple[Array, Array]:
        """Return the largest displacement (N,) m and velocity (N,) m/s that it imposes."""
        return self.initial(chain)

    def strongest(self, chain: Chain) -> tuple[float, float]:
        """Return the largest displacement and speed that it imposes on any grain, m and m/s."""
        displacement, velocity = self.largest(chain)
        return float(np.abs(displacement).max()), float(np.abs(velocity).max())

    def energy(self, chain: Chain) -> float:
        """Return the energy above rest, J: that at t = 0, or infinite if it does work later."""
        return np.inf if self.does_work else float(chain.excess_energy(*self.initial(chain)))

    @abstractmethod
    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that it moves."""

    @abstractmethod
    def part(self, first: int, last: int) -> Excitation:
        """Return the excitation of `Chain.part(first, last)`, which has all that it moves."""

    def scaled(self, factor: float) -> Self:
        """Return the excitation, so many times as strong."""
        fields = self.given()
        return self.replace(**{key: factor * fields[key] for key in self.strength if key in fields})

    def energy_norm(self, chain: Chain, duration: float) -> float:
        """Bound sqrt(2 E), J^(1/2), of the energy E that it puts into the linearised chain."""
        u, v = self.initial(chain)
        contacts = chain.contacts
        kinetic = (chain.masses * v**2).sum()
        return float(np.sqrt(kinetic + (contacts.stiffness * contacts.closer(u) ** 2).sum()))

    def push(
        self, chain: Chain, time: Array, force: Array, rate: Array, velocity: Array
    ) -> Push | None:
        """Return the push from outside at these times, (T,) s; None if nothing acts after t = 0.

        Parameters
        ----------
        force, rate : (T, N+1) arrays
            Force of every contact less that at rest, N, and its rate, N/s.
        velocity : (T, N) array
            Of every grain, m/s.
        """
        return None


class OneGrain(Excitation):
    """An excitation of one grain, to be chosen."""

    grain: Number

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if the chain has no such grain, or holds it."""
        if self.grain > chain.grains:
            yield "grain", f"there is no grain {self.grain}: the chain has {chain.grains}"
        elif self.grain > chain.movable:
            yield "grain", f"grain {self.grain} is held; choose one of 1 to {chain.movable}"

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the grain that it moves, as the first and the last."""
        return self.grain, self.grain

    def part(self, first: int, last: int) -> Excitation:
        """Return the excitation with its grain as it is numbered among grains first ... last."""
        return self if first == 1 else self.replace(grain=self.grain - first + 1)

    def at_grain(self, chain: Chain, value: float) -> Array:
        """Return an (N,) array with this value for the grain, and 0 for the others."""
        array = np.zeros(chain.grains)
        array[self.grain - 1] = value
        return array
