"""What a notebook shows of a chain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..util.notebook import Shown
from ..util.plotting import axes_in_units, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DETAILED_GRAINS = 1_000_000  # longest chain that a notebook looks at in detail
DRAWN = 2000  # points of a curve in a picture


class AtRest(Shown):
    """The table and the picture of a chain at rest."""

    def _summary(self: Any) -> Iterator[Sequence[str]]:
        yield from super()._summary()
        if self.grains <= DETAILED_GRAINS:
            yield (
                "unit of length",
                f"{self.length_scale:.6g} m",
                "overlap of the first contact at rest",
            )
            yield "unit of time", f"{self.time_scale:.6g} s", "unit of the paper's tau"
            yield "mass", f"{self.masses.sum():.6g} kg", "of all grains"

    def _picture(self: Any) -> str:
        return super()._picture() if self.grains <= DETAILED_GRAINS else ""

    def plot(self: Any, ax: Axes | None = None) -> Axes:
        """Draw masses and overlaps at rest over their largest values; returns the axes."""
        ax = axes_in_units(ax, "", "")
        number = np.arange(1, self.grains + 1)
        some = slice(None, None, -(-self.grains // DRAWN))
        drawn = [
            ("mass", "kg", number, self.masses),
            ("overlap at rest", "m", number[:-1] + 0.5, self.equilibrium_overlap),
        ]
        for name, unit, place, values in drawn:
            if values.any():
                ax.plot(
                    place[some],
                    (values / values.max())[some],
                    ".-",
                    lw=1,
                    label=f"{name} / {values.max():.3g} {unit}",
                )
        ax.set(xlabel="grain, from the top", ylabel="over the largest", ylim=(0, 1.3))
        legend(ax, loc="upper left")
        return ax
