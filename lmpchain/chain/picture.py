"""Table and picture of a chain at rest, as displayed in a notebook."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed

# Longest chain whose arrays are computed only for display in a notebook.
DETAILED_GRAINS = 1_000_000
DRAWN_POINTS = 2000  # Largest number of points of a curve.


class ChainPicture(Shown):
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
        """Draw masses and overlaps at rest, relative to their largest values; return the axes."""
        ax = chart(ax, "grain, from the top", "over the largest")
        number = np.arange(1, self.grains + 1)
        every = -(-self.grains // DRAWN_POINTS)
        curves = [
            ("mass", "g", number, 1e3 * self.masses),
            # A contact is drawn between its two grains.
            ("overlap at rest", "m", number[:-1] + 0.5, self.equilibrium_overlap),
        ]
        for name, unit, position, values in curves:
            # All overlaps are 0 in the sonic vacuum.
            if values.any():
                ax.plot(
                    position[::every],
                    (values / values.max())[::every],
                    ".-",
                    lw=1,
                    label=f"{name} / {prefixed(values.max(), unit, 3)}",
                )
        ax.set(ylim=(0, 1.3))
        return finish(ax, loc="upper left")
