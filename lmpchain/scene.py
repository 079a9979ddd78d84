"""The scene: a chain, how it is struck and what is recorded. It says what, never how."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from os import PathLike
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator, Field

from .chain import LARGEST_OVERLAP, Chain
from .fields import NOT_GIVEN, Array, Checked, Positive, Real, Vector, Whole


class Excitation(Checked):
    """How the chain is set in motion at t = 0."""

    kind: ClassVar[str]

    @abstractmethod
    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement (N,) m and velocity (N,) m/s at t = 0, positive downward."""

    @abstractmethod
    def faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield what this chain does not allow."""


Number = Annotated[Whole, Field(ge=1)]


class _OneGrain(Excitation):
    grain: int

    def faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        if self.grain > chain.grains:
            yield "grain", f"there is no grain {self.grain}: the chain has {chain.grains}"
        elif self.grain > chain.movable:
            yield "grain", f"grain {self.grain} is held; choose one of 1 to {chain.movable}"

    def _at_grain(self, chain: Chain, value: float) -> Array:
        array = np.zeros(chain.grains)
        array[self.grain - 1] = value
        return array


class Impulse(_OneGrain):
    """A velocity given to one grain, m/s, positive downward.

    Examples
    --------
    >>> Impulse(velocity=8.57e-4).grain
    1
    """

    kind: ClassVar[str] = "impulse"
    velocity: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return np.zeros(chain.grains), self._at_grain(chain, self.velocity)


class Displacement(_OneGrain):
    """One grain moved from its equilibrium and let go, m, positive downward."""

    kind: ClassVar[str] = "displacement"
    displacement: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return self._at_grain(chain, self.displacement), np.zeros(chain.grains)


class Profile(Excitation):
    """Displacement (N,) m and velocity (N,) m/s of every grain at t = 0; what is left out is zero."""

    kind: ClassVar[str] = "profile"
    displacement: Vector = NOT_GIVEN
    velocity: Vector = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.displacement is None and self.velocity is None:
            yield "displacement", "give displacement or velocity of every grain, or a file with both"

    def faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield what this chain does not allow."""
        for key in ("displacement", "velocity"):
            value = getattr(self, key)
            if value is None:
                continue
            if len(value) != chain.grains:
                yield key, f"must have one entry a grain, {chain.grains}, not {len(value)}"
            elif chain.bottom == "fixed" and value[-1] != 0:
                yield key, f"must be 0 for grain {chain.grains}, which is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        rest = np.zeros(chain.grains)
        return (
            rest.copy() if self.displacement is None else self.displacement.copy(),
            rest.copy() if self.velocity is None else self.velocity.copy(),
        )


EXCITATIONS: dict[str, type[Excitation]] = {e.kind: e for e in (Impulse, Displacement, Profile)}


def _selection(value: Any) -> Any:
    """Grains to record: "all", "1:200" or a list of numbers."""
    if isinstance(value, str):
        parts = value.split(":")
        if value != "all" and not (len(parts) == 2 and all(p.isascii() and p.isdigit() for p in parts)):
            raise ValueError(f'must be "all", a range such as "1:200", or a list of grains (got {value!r})')
        return value
    try:
        numbers = [v.item() if isinstance(v, np.generic) else v for v in value]
    except TypeError:
        numbers = []
    if not numbers or any(isinstance(v, bool) or not isinstance(v, int) for v in numbers):
        raise ValueError('must be "all", a range such as "1:200", or a list of grains')
    return tuple(numbers)


class Recording(Checked):
    """When and which grains are recorded: `samples` times from 0 to `duration`, both included."""

    duration: Positive
    samples: Annotated[Whole, Field(ge=2, le=10**8)] = 101
    grains: Annotated[str | tuple[int, ...], BeforeValidator(_selection)] = "all"

    def faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield what this chain does not allow."""
        first, last = self._ends(chain)
        if not 1 <= first <= last <= chain.grains:
            yield "grains", f"grains are numbered 1 to {chain.grains} (got {first} to {last})"
        elif isinstance(self.grains, tuple) and len(set(self.grains)) < len(self.grains):
            yield "grains", "names a grain twice"

    def _ends(self, chain: Chain) -> tuple[int, int]:
        if self.grains == "all":
            return 1, chain.grains
        if isinstance(self.grains, str):
            first, last = self.grains.split(":")
            return int(first), int(last)
        return min(self.grains), max(self.grains)

    def numbers(self, chain: Chain) -> np.ndarray:
        """Return the recorded grains, (G,) numbers from 1."""
        if isinstance(self.grains, tuple):
            return np.array(self.grains)
        first, last = self._ends(chain)
        return np.arange(first, last + 1)


class Scene(Recording):
    """A chain, an excitation, and what is recorded.

    Parameters
    ----------
    chain : Chain
    excitation : Impulse, Displacement or Profile
    duration : float
        s.
    samples : int
        Number of recorded times, t = 0 and t = duration included.
    grains : "all", "first:last" or list of int
        Recorded grains.

    Raises
    ------
    InputError
        With every fault found.

    Examples
    --------
    >>> from lmpchain import GLASS
    >>> scene = Scene(
    ...     chain=Chain(grains=120, material=GLASS, diameter=1e-3),
    ...     excitation=Impulse(velocity=8.57e-4),
    ...     duration=100e-6,
    ... )
    >>> round(scene.strike_number, 2)
    8.48
    """

    chain: Chain
    excitation: Excitation

    def _faults(self) -> Iterator[tuple[str, str]]:
        yield from self.excitation.faults(self.chain)
        yield from self.faults(self.chain)
        yield from () if list(self.excitation.faults(self.chain)) else strike_faults(self.chain, self.excitation)

    @property
    def time(self) -> Array:
        """Recorded times, (T,) s."""
        return np.linspace(0.0, self.duration, self.samples)

    @property
    def recorded(self) -> np.ndarray:
        """Recorded grains, (G,) numbers from 1."""
        return self.numbers(self.chain)

    def initial(self) -> tuple[Array, Array]:
        """Return displacement (N,) m and velocity (N,) m/s at t = 0."""
        return self.excitation.initial(self.chain)

    @property
    def energy(self) -> float:
        """Energy that the excitation puts in, J."""
        return float(self.chain.excess_energy(*self.initial()))

    @property
    def strike_number(self) -> float:
        """Strike over what the contact below holds: v0 / (eps_n omega_n) or phi_0 / eps_n.

        Linear theory needs it to be far below 1; it is infinite in the sonic vacuum.
        """
        chain = self.chain
        u, v = self.initial()
        below = np.minimum(np.arange(chain.movable), chain.grains - 2)
        u, v = u[: chain.movable], v[: chain.movable]
        if not chain.compressed:
            return float(np.inf) if np.any(u != 0) or np.any(v != 0) else 0.0
        eps = chain.equilibrium_overlap[below]
        omega = np.sqrt(chain.linear_stiffness[below] / chain.masses[: chain.movable])
        return float(max(np.abs(u / eps).max(), np.abs(v / (eps * omega)).max()))

    @classmethod
    def from_toml(cls, path: str | PathLike[str]) -> Scene:
        """Read a scene file; raises `InputError` with every fault in it."""
        from .scenefile import read

        return read(path)

    def to_toml(self, path: str | PathLike[str]) -> None:
        """Write a scene file that `from_toml` reads back equal."""
        from .scenefile import write

        write(self, path)


def first_overlaps(chain: Chain, excitation: Excitation) -> Array:
    """Overlap of every contact at the start, or when its two grains meet alone, (N-1,) m."""
    u, v = excitation.initial(chain)
    m = chain.masses
    pair_mass = m[:-1] * m[1:] / (m[:-1] + m[1:])
    power = chain.exponent + 1
    closing = np.maximum(v[:-1] - v[1:], 0.0)
    two_body = (power / 2 * pair_mass * closing**2 / chain.contact_constants) ** (1 / power)
    return np.maximum(chain.equilibrium_overlap + u[:-1] - u[1:], two_body)


def strike_faults(chain: Chain, excitation: Excitation) -> Iterator[tuple[str, str]]:
    """Yield a fault if the excitation squeezes a contact beyond what Hertz's law describes."""
    relative = first_overlaps(chain, excitation) / chain.mean_diameters
    if relative.max() > LARGEST_OVERLAP:
        worst = int(relative.argmax())
        key = "displacement" if isinstance(excitation, Displacement) else "velocity"
        yield (
            key,
            f"squeezes contact {worst + 1} to {relative[worst]:.2g} of the diameter, more than "
            f"{LARGEST_OVERLAP:g}: strike more gently",
        )
