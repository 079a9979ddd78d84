"""Plain numbers at ticks, with the prefixed unit in the label of the axis."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from matplotlib.ticker import EngFormatter

ROUND_OFF = 1e-14  # Fraction of the largest tick; smaller ticks are set to 0.


class UnitFormatter(EngFormatter):
    """Tick formatter with plain numbers and a unit prefix for the axis, as in "energy (µJ)".

    If the axis has no label, the ticks have the unit. The position of the mouse pointer is always
    shown with the unit.
    """

    axis: Any

    def format_ticks(self, values: list[float]) -> list[str]:
        """Return the numbers at the ticks, and write their unit to the label of the axis."""
        label = self.axis.label
        text = label.get_text()
        if not text:
            return super().format_ticks(values)
        power = self._power(np.asarray(values, float))
        prefixes = self.ENG_PREFIXES
        # Remove the unit of the previous drawing, which may have had other limits.
        prefix = "|".join(filter(None, prefixes.values()))
        bare = re.sub(rf" \((?:{prefix})?{re.escape(self.unit)}\)$", "", text)
        with_unit = f"{bare} ({prefixes[power]}{self.unit})"
        if with_unit != text:
            label.set_text(with_unit)
        scaled = np.asarray(values, float) / 10.0**power
        scaled[np.abs(scaled) < ROUND_OFF * np.abs(scaled).max(initial=0.0)] = 0.0
        numbers = [
            np.format_float_positional(value, precision=9, fractional=False, trim="-")
            for value in scaled
        ]
        return [number.replace("-", "\N{MINUS SIGN}") for number in numbers]

    def _power(self, values: np.ndarray) -> int:
        """Return the power of ten for the ticks in view, or for their middle if logarithmic."""
        low, high = sorted(self.axis.get_view_interval())
        seen = np.abs(values[(values >= low) & (values <= high)])
        seen = seen[seen > 0]
        if not seen.size:
            return 0
        logarithmic = self.axis.get_scale() == "log"
        size = np.sqrt(seen.min() * seen.max()) if logarithmic else seen.max()
        # Some locators give 1000.0000000001 or 999.9999999 for a thousand.
        power = 3 * int(np.floor(np.log10(size * (1 + 1e-9)) / 3))
        return min(max(power, min(self.ENG_PREFIXES)), max(self.ENG_PREFIXES))
