"""Summary of all fits of the theory to a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

from ...errors import InputError
from ...trajectory.trajectory import Trajectory
from ...util.notebook import Shown
from ...util.tables import align, finite, wrap
from .column import fit_continuum, fit_exponents
from .passage import fit_passage
from .solitary import fit_soliton
from .table import TITLES, Fitted, FittedNumber
from .waves import ModeFit, fit_bessel, fit_modes

# Strike number up to which linear theory has errors of about 1 % in peak velocities.
WEAK_STRIKE = 0.3  # See analysis/calibration/fit_thresholds.py.
MOST_MODES = 3000  # Largest number of grains for which computing all eigenmodes takes only seconds.


@dataclass(frozen=True, repr=False)
class Summary(Shown):
    """All fits that apply to a trajectory.

    Attributes
    ----------
    strike_number : float
        Strike number of the scene.
    rows : tuple of FittedNumber
        Fitted numbers of all fits.
    left_out : tuple of (fit, reason)
        Fits that do not apply, with the reasons.
    notes : tuple of str
        Remarks of the fits, such as excluded grains and asymptotic laws.
    """

    strike_number: float
    rows: tuple[FittedNumber, ...]
    left_out: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the rows for a JSON file; numbers that are not finite become None."""
        return finite({"strike_number": self.strike_number}) | {
            "rows": [finite(asdict(row)) for row in self.rows],
            "notes": list(self.notes),
            "left_out": [{"fit": fit, "reason": reason} for fit, reason in self.left_out],
        }

    def cells(self) -> Iterator[Sequence[str]]:
        """Yield the rows of the table as text, titles first."""
        yield "fit", *TITLES
        for _, rows in groupby(self.rows, key=lambda row: row.fit):
            for first, row in enumerate(rows):
                yield "" if first else row.fit, *row.cells()

    _summary = cells

    def table(self) -> str:
        """Return the numbers as text, within 80 columns."""
        lines = align(self.cells()) if self.rows else []
        lines += wrap(*self.notes, *self._brief_reasons())
        remark = (
            ""
            if self.strike_number <= WEAK_STRIKE
            else ", so linear theory is not expected to hold"
        )
        return "\n".join([*lines, f"strike number {self.strike_number:.3g}{remark}"])

    __str__ = table

    def _brief_reasons(self) -> Iterator[str]:
        """Yield the main reason why fits are left out, one line for all fits that share it."""
        names: dict[str, list[str]] = {}
        for fit, reason in self.left_out:
            names.setdefault(reason.partition("; ")[0], []).append(fit)
        for reason, fits in names.items():
            yield f"left out: {', '.join(fits)} ({reason})"


def summary(trajectory: Trajectory) -> Summary:
    """Apply every suitable fit to a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine, or a trajectory that was read from a dump.

    Returns
    -------
    Summary
        Fitted numbers, and the reasons why other fits were left out.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=30, diameter=1e-3, gravity=0.0, top_load=0.1)
    >>> duration = 20 * chain.time_scale
    >>> strike = lmpchain.Impulse(velocity=1e-7)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=duration)
    >>> fits = summary(lmpchain.simulate(scene, engine="native"))
    >>> sorted({row.fit for row in fits.rows}), [fit for fit, _ in fits.left_out]
    (['bessel', 'front', 'modes'], ['continuum', 'exponents', 'soliton'])
    """
    rows: list[FittedNumber] = []
    notes: list[str] = []
    left_out = []
    fits: dict[str, Callable[[Trajectory], Fitted]] = {
        "front": fit_passage,
        "modes": _modes,
        "bessel": fit_bessel,
        "continuum": fit_continuum,
        "exponents": fit_exponents,
        "soliton": fit_soliton,
    }
    for name, make in fits.items():
        try:
            fit = make(trajectory)
        except InputError as error:
            left_out.append((name, "; ".join(f"{key}: {message}" for key, message in error.faults)))
            continue
        rows += fit.rows()
        notes += [f"{name}: {note}" for note in fit.notes()]
    strike = float(trajectory.scene.strike_number)
    return Summary(strike, tuple(rows), tuple(left_out), tuple(notes))


def _modes(trajectory: Trajectory) -> ModeFit:
    if trajectory.scene.chain.movable > MOST_MODES:
        raise InputError.at("grains", f"more than {MOST_MODES} take long: call fit_modes directly")
    fit = fit_modes(trajectory)
    if not fit.energy.any():
        raise InputError.at("excitation", "nothing moves")
    return fit
