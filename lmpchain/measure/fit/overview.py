"""All fits of the theory to a trajectory, and their summary."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

import numpy as np

from ...errors import InputError
from ...trajectory.trajectory import Trajectory
from ...util.notebook import Shown
from ...util.tables import align, finite, number
from .column import fit_continuum, fit_exponents
from .solitary import fit_soliton
from .waves import fit_bessel, fit_modes

# strike number up to which linear theory is right to about 1 % in peak velocities
WEAK_STRIKE = 0.3  # analysis/calibration/fit_thresholds.py
MOST_MODES = 3000  # grains up to which all eigenmodes take seconds only


@dataclass(frozen=True)
class Row:
    """One fitted number.

    Attributes
    ----------
    fit, quantity, unit : str
    value, error : float
        The error as the fit defines it; NaN where there is none.
    expected : float
        By the scene and the theory; NaN where they say nothing.
    """

    fit: str
    quantity: str
    value: float
    error: float = math.nan
    expected: float = math.nan
    unit: str = ""


@dataclass(frozen=True, repr=False)
class Summary(Shown):
    """All fits that apply to a trajectory.

    Attributes
    ----------
    strike_number : float
    rows : tuple of Row
    left_out : tuple of (fit, reason)
        What does not apply, and why.
    """

    strike_number: float
    rows: tuple[Row, ...]
    left_out: tuple[tuple[str, str], ...]

    def to_json(self) -> dict[str, Any]:
        """Return the rows for a JSON file; numbers that are not finite become None."""
        return finite({"strike_number": self.strike_number}) | {
            "rows": [finite(asdict(row)) for row in self.rows],
            "left_out": [{"fit": fit, "reason": reason} for fit, reason in self.left_out],
        }

    def cells(self) -> Iterator[Sequence[str]]:
        """Yield the rows of the table as text, titles first."""
        yield "fit", "quantity", "value", "error", "expected", "unit"
        for _, rows in groupby(self.rows, key=lambda row: row.fit):
            for first, row in enumerate(rows):
                numbers = (
                    _round(row.value, row.error),
                    number(row.error, ".1g"),
                    _round(row.expected, row.error),
                )
                yield "" if first else row.fit, row.quantity, *numbers, row.unit

    _summary = cells

    def table(self) -> str:
        """Return the numbers as text."""
        lines = align(self.cells()) if self.rows else []
        lines += [f"left out: {fit} ({reason})" for fit, reason in self.left_out]
        remark = (
            ""
            if self.strike_number <= WEAK_STRIKE
            else ", so linear theory is not expected to hold"
        )
        return "\n".join([*lines, f"strike number {self.strike_number:.3g}{remark}"])


def summary(trajectory: Trajectory) -> Summary:
    """Fit everything that applies to the scene of a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        Of any engine, or read from a dump.

    Returns
    -------
    Summary
        A row for each fitted number, and why other fits were left out.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=30, diameter=1e-3, gravity=0.0, top_load=0.1)
    >>> duration = 20 * chain.time_scale
    >>> strike = lmpchain.Impulse(velocity=1e-7)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=duration)
    >>> fits = summary(lmpchain.simulate(scene, engine="native"))
    >>> sorted({row.fit for row in fits.rows}), [fit for fit, _ in fits.left_out]
    (['bessel', 'modes'], ['continuum', 'exponents', 'soliton'])
    """
    rows: list[Row] = []
    left_out = []
    fits = {
        "modes": _modes,
        "bessel": _bessel,
        "continuum": _continuum,
        "exponents": _exponents,
        "soliton": _soliton,
    }
    for name, fit in fits.items():
        try:
            rows += fit(trajectory)
        except InputError as error:
            left_out.append((name, "; ".join(f"{key}: {message}" for key, message in error.faults)))
    return Summary(float(trajectory.scene.strike_number), tuple(rows), tuple(left_out))


def _modes(trajectory: Trajectory) -> list[Row]:
    scene = trajectory.scene
    if scene.chain.movable > MOST_MODES:
        raise InputError.at(
            "grains", f"with more than {MOST_MODES} it takes long: call fit_modes itself"
        )
    fit = fit_modes(trajectory)
    if not fit.energy.any():
        raise InputError.at("excitation", "nothing moves")
    mode = int(fit.energy.argmax())
    total = float(fit.energy.sum())
    share = f"share of mode {mode + 1}, the strongest"
    frequency = float(fit.frequency[mode] / (2 * np.pi))
    return [
        Row("modes", "energy of all modes", total, expected=scene.energy, unit="J"),
        Row("modes", share, fit.share[mode], fit.share_error[mode]),
        Row("modes", "its frequency", frequency, unit="Hz"),
        Row("modes", "residual of the linear motion", float(fit.residual.max()), expected=0.0),
    ]


def _bessel(trajectory: Trajectory) -> list[Row]:
    fit = fit_bessel(trajectory)
    unit = "m/s" if fit.field == "velocity" else "m"
    values = {
        "amplitude": (fit.amplitude, unit),
        "wave speed": (fit.rate, "grains/s"),
        "delay": (fit.delay, "s"),
        "kappa": (fit.kappa, ""),
    }
    rows = [
        Row("bessel", name, value, float(error), float(expected), unit)
        for (name, (value, unit)), error, expected in zip(
            values.items(), fit.error, fit.expected, strict=True
        )
    ]
    return [*rows, Row("bessel", "residual", fit.residual, expected=0.0)]


def _continuum(trajectory: Trajectory) -> list[Row]:
    fit = fit_continuum(trajectory)
    rows = [Row("continuum", "amplitude C of Eq. (35)", fit.amplitude, fit.error, fit.expected)]
    if fit.front:
        law = fit.front
        exponent, factor = law.expected.tolist()
        rows += [
            Row("continuum", "exponent of the front", law.exponent, float(law.error[0]), exponent),
            Row("continuum", "factor of the front", law.factor, float(law.error[1]), factor),
        ]
    return [*rows, Row("continuum", "residual", fit.residual, expected=0.0)]


def _exponents(trajectory: Trajectory) -> list[Row]:
    fit = fit_exponents(trajectory)
    return [
        Row("exponents", name, float(law.exponent), float(law.error[0]), fit.expected[name])
        for name, law in fit.laws.items()
    ]


def _soliton(trajectory: Trajectory) -> list[Row]:
    fit = fit_soliton(trajectory)
    _, speed, width = fit.expected.tolist()
    errors = fit.error.tolist()
    formula = "speed by the long-wave formula"
    return [
        # the height is that of the exact wave, with which the others are compared
        Row("soliton", "largest velocity", fit.amplitude, errors[0], unit="m/s"),
        Row("soliton", "speed", fit.speed, errors[1], speed, "grains/s"),
        Row("soliton", "width", fit.width, errors[2], width, "grains"),
        Row("soliton", formula, fit.formula, expected=speed, unit="grains/s"),
    ]


def _round(value: float, error: float = math.nan) -> str:
    """Return a number rounded to the digits that its error leaves significant."""
    if math.isnan(value):
        return ""
    if not error > 0 or not math.isfinite(error) or value == 0:
        # six digits of a number whose error is unknown; two where all are significant or none
        return f"{value:.6g}" if math.isnan(error) else f"{value:.2g}"
    digits = max(2, min(12, 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(error))))
    return f"{value:.{digits}g}"
