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
        Must lie in the chain: the packet is 1.5e-8 of its height there.
    cut : float
        Beyond, the packet is nothing.
    """

    inside: float = 6.0
    cut: float = 9.0


EXTENT = Extent()


class Packet(Excitation):
    """A Gaussian packet of linear waves of one frequency that travels downward.

    Velocities of grains and strains of contacts are samples of one wave ``A(x) cos(theta(x))`` at
    whole and half numbers: the chain is a row of both in turn, each of which drives its neighbours,
    so waves that go down differ from those that go up in wave number. The local wave number q
    follows from ``w = 2 sqrt(k/m) sin(q/2)`` contact by contact, the amplitude from the energy that
    flows, the envelope from the travel time (WKB). On a uniform chain the part that goes up is what
    is left of the Gaussian in q below 0 and above pi: in amplitude some ``exp(-(q width)^2/2)`` and
    ``exp(-((pi - q) width)^2/2)``. Where stiffness and mass change it is what the chain reflects on
    the way, and what a change within a wavelength adds.

    Parameters
    ----------
    frequency : float
        Hz.
    width : float
        Standard deviation of the envelope ``exp(-x^2 / (2 width^2))``, in grains, where its middle
        is.
    grain : int
        Its middle.
    amplitude : float
        Height of the envelope of displacements in its middle, m, where the wave itself is 0 and
        velocities have their crest: no grain need be displaced as far. Linear theory holds if it is
        small.

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
        """Yield a fault if the packet does not fit into the chain, or cannot travel there."""
        if self.grain > chain.movable:
            yield "grain", f"must be one that moves, 1 to {chain.movable} (got {self.grain})"
        elif chain.loose_grains:
            yield "chain.load_grain", f"a packet is linear, and {chain.loose}"
        elif not chain.compressed:
            yield "kind", "there are no linear waves without gravity and load: give a top_load"
        else:
            first, last = self._within(chain, EXTENT.inside)
            if first < 1 or last > chain.movable:
                length = f"{EXTENT.inside:g} widths long on either side"
                yield "width", f"the packet is {length}, which does not fit in the chain"
                return
            hops = self._hops(chain, first, last)
            # w = 2 sqrt(k/m) sin(q/2) has a real wave number below 2 sqrt(k/m) only
            if (2 * np.pi * self.frequency >= 2 * hops).any():
                limit = f"{float(hops.min() / np.pi):.4g} Hz"
                # two hops a grain
                slowest = first + int(hops.argmin()) // 2
                yield (
                    "frequency",
                    f"must be below the highest that travels at grain {slowest}, {limit}",
                )

    def _within(self, chain: Chain, widths: float) -> tuple[int, int]:
        """Return the first and the last grain so many widths around the middle."""
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
        """Return the packet with its middle as it is numbered among grains first ... last."""
        return self.replace(grain=self.grain - first + 1)

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        first, last = self.reach(chain)
        omega = 2 * np.pi * self.frequency
        hops = self._hops(chain, first, last)
        # places are those of the row of grains and contacts in turn
        middle = 2 * (self.grain - first)
        # a turning point lies far out, where the packet is nothing: any real wave number does there
        ratio = np.minimum(omega / (2 * hops), 0.999)
        speed = 2 * hops * np.sqrt(1 - ratio**2)  # group velocity, places a second
        phase = np.append(0.0, np.cumsum(np.arcsin(ratio)))
        arrival = np.append(0.0, np.cumsum(1 / speed))
        # at a place, the geometric mean of the speeds on either side
        local_speed = np.sqrt(np.append(speed[:1], speed) * np.append(speed, speed[-1:]))
        distance = (arrival - arrival[middle]) * local_speed[middle] / (2 * self.width)
        envelope = np.exp(-(distance**2) / 2)
        # the flow of energy, its density times the speed, is the same everywhere (WKB)
        flow = chain.masses[self.grain - 1] * local_speed[middle]
        height = self.amplitude * omega * np.sqrt(flow / local_speed)
        wave = height * envelope * np.cos(phase - phase[middle])
        v = wave[::2] / np.sqrt(chain.masses[first - 1 : last])
        strain = wave[1::2] / np.sqrt(chain.contacts.stiffness[first:last])
        # no net strain, or the grains beyond one end would be displaced for good
        strain -= strain.sum() * envelope[1::2] / envelope[1::2].sum()
        u = np.append(np.cumsum(strain[::-1])[::-1], 0.0)
        fields = np.zeros((2, chain.grains))
        fields[:, first - 1 : last] = u, v
        return fields[0], fields[1]
