"""A packet of linear waves that travels downward, as initial displacements and velocities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.validation import Positive, Real
from .base import Excitation, Number


@dataclass(frozen=True)
class Extent:
    """Half lengths of a packet in units of its width.

    Attributes
    ----------
    inside : float
        This part must fit into the chain; the envelope is 1.5e-8 of its height at its ends.
    cut : float
        The packet is truncated at this distance.
    """

    inside: float = 6.0
    cut: float = 9.0


EXTENT = Extent()


class Packet(Excitation):
    """A Gaussian packet of linear waves of one frequency that travels downward.

    Velocities of grains and strains of contacts are samples of one wave ``A(x) cos(theta(x))`` at
    integer and half-integer positions. The chain is an alternating row of both, in which each
    drives its neighbours, so that upgoing and downgoing waves differ in wave number. The local wave
    number q follows from ``w = 2 sqrt(k/m) sin(q/2)`` for each contact, the amplitude from a
    constant energy flow, the envelope from the travel time (WKB). On a uniform chain the upgoing
    part is the tail of the Gaussian at q below 0 and above pi, with amplitudes of about ``exp(-(q
    width)^2/2)`` and ``exp(-((pi - q) width)^2/2)``. If stiffness and mass vary, the chain also
    reflects a part of the wave, and variations within a wavelength add an error.

    Parameters
    ----------
    frequency : float
        Hz.
    width : float
        Standard deviation of the envelope ``exp(-x^2 / (2 width^2))`` at its centre, in grains.
    grain : int
        Number of the grain at the centre.
    amplitude : float
        Height of the envelope of displacements at its centre, m. The wave itself is 0 there, and
        velocities have their maximum; the largest displacement of a grain may be smaller. Linear
        theory holds if the amplitude is small.

    Examples
    --------
    >>> chain = Chain(grains=200, diameter=1e-3, gravity=0, top_load=1, top="wall", bottom="wall")
    >>> u, v = Packet(frequency=2e4, width=10, grain=80, amplitude=1e-12).initial(chain)
    >>> int(abs(v).argmax()) + 1
    80
    """

    kind: ClassVar[str] = "packet"
    of_chain: ClassVar[bool] = True
    strength: ClassVar[tuple[str, ...]] = ("amplitude",)
    frequency: Positive
    width: Positive
    grain: Number
    amplitude: Real

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if the packet does not fit into the chain, or cannot propagate there."""
        if self.grain > chain.movable:
            yield "grain", f"must be a grain that moves, 1 to {chain.movable} (got {self.grain})"
        elif chain.loose_grains:
            yield "chain.load_grain", f"a packet requires a linear chain, but {chain.loose}"
        elif not chain.compressed:
            yield "kind", "there are no linear waves without gravity and load: give a top_load"
        else:
            first, last = self._within(chain, EXTENT.inside)
            if first < 1 or last > chain.movable:
                length = f"{EXTENT.inside:g} widths to either side"
                yield "width", f"the packet extends {length} and does not fit into the chain"
                return
            hops = self._hops(chain, first, last)
            # A real wave number exists only below 2 sqrt(k/m), because w = 2 sqrt(k/m) sin(q/2).
            if (2 * np.pi * self.frequency >= 2 * hops).any():
                limit = f"{float(hops.min() / np.pi):.4g} Hz"
                # There are two hops for each grain.
                slowest = first + int(hops.argmin()) // 2
                yield (
                    "frequency",
                    f"must be below the cut-off frequency at grain {slowest}, {limit}",
                )

    def _within(self, chain: Chain, widths: float) -> tuple[int, int]:
        """Return the first and the last grain within a number of widths around the centre."""
        far = int(min(np.ceil(widths * self.width), chain.grains))
        return self.grain - far, self.grain + far

    @staticmethod
    def _hops(chain: Chain, first: int, last: int) -> Array:
        """Return sqrt(k/m), 1/s, from each grain to the contact below, and on to the next grain."""
        k = chain.contacts.stiffness[first:last]
        m = chain.masses[first - 1 : last]
        return np.sqrt(np.column_stack((k / m[:-1], k / m[1:]))).ravel()

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that it moves."""
        first, last = self._within(chain, EXTENT.cut)
        return max(1, first), min(chain.movable, last)

    def part(self, first: int, last: int) -> Packet:
        """Return the packet with its centre renumbered within grains first ... last."""
        return self.replace(grain=self.grain - first + 1)

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        first, last = self.reach(chain)
        omega = 2 * np.pi * self.frequency
        hops = self._hops(chain, first, last)
        # Positions count grains and contacts alternately.
        middle = 2 * (self.grain - first)
        # A turning point is far from the centre, where the packet vanishes, so any real wave number
        # suffices there.
        ratio = np.minimum(omega / (2 * hops), 0.999)
        speed = 2 * hops * np.sqrt(1 - ratio**2)  # group velocity, positions per second
        phase = np.append(0.0, np.cumsum(np.arcsin(ratio)))
        arrival = np.append(0.0, np.cumsum(1 / speed))
        # The speed at a position is the geometric mean of the speeds on either side.
        local_speed = np.sqrt(np.append(speed[:1], speed) * np.append(speed, speed[-1:]))
        distance = (arrival - arrival[middle]) * local_speed[middle] / (2 * self.width)
        envelope = np.exp(-(distance**2) / 2)
        # The energy flow, energy density times speed, is constant (WKB).
        flow = chain.masses[self.grain - 1] * local_speed[middle]
        height = self.amplitude * omega * np.sqrt(flow / local_speed)
        wave = height * envelope * np.cos(phase - phase[middle])
        v = wave[::2] / np.sqrt(chain.masses[first - 1 : last])
        strain = wave[1::2] / np.sqrt(chain.contacts.stiffness[first:last])
        # The net strain must be 0, otherwise grains beyond one end would be displaced permanently.
        strain -= strain.sum() * envelope[1::2] / envelope[1::2].sum()
        u = np.append(np.cumsum(strain[::-1])[::-1], 0.0)
        fields = np.zeros((2, chain.grains))
        fields[:, first - 1 : last] = u, v
        return fields[0], fields[1]
