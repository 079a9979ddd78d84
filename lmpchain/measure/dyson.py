"""Eq. (22), velocities weighted by Dyson's distribution, and averages over random chains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..chain.chain import Chain
from ..chain.contact_law import Contacts
from ..errors import InputError, shown
from ..theory import dyson
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import (
    COLOURS,
    PRINTED_WIDTH,
    Axes,
    legend,
    letter_panels,
    panels,
    set_title,
    window,
)
from ..util.tables import align, counted, number, wrap
from ..util.tabular import NamedColumn, Tabular, number_columns
from .bodies import motion

if TYPE_CHECKING:
    from ..disorder.averages import Ensemble

__dir__ = listed(__name__)

DASHES = ("-", "--", "-.", ":")
MEANING = "a sum over the grains of one chain, weighted by D_m(kappa_n): no average over disorder"


@dataclass(frozen=True, eq=False, repr=False)
class DysonSums(Shown, Tabular):
    """Eq. (22) for one trajectory and several orders m.

    Attributes
    ----------
    m : (M,) array
        Orders.
    time : (T,) array
        Times, s.
    tau : (T,) array
        Time in units of `Chain.time_scale`.
    kappa : (N,) array
        Stiffness of the contact below each grain relative to the first contact.
    velocity : (T, N) array
        Velocities of all grains, m/s.
    weight : (M, N) array
        D_m(kappa_n), Eq. (23) as printed.
    as_printed : (M, T) array
        sum_n D_m(kappa_n) velocity_n, m/s.
    normalised : (M, T) array
        `as_printed` divided by sum_n D_m(kappa_n), m/s.
    unit : float
        Strike velocity, m/s, by which displayed velocities are divided; 1 if no single grain was
        struck.
    """

    m: Array
    time: Array
    tau: Array
    kappa: Array
    velocity: Array
    weight: Array
    as_printed: Array
    normalised: Array
    unit: float

    def _picture(self) -> str:
        # The picture needs random chains.
        return ""

    @property
    def unit_name(self) -> str:
        """Unit in which velocities are shown."""
        return "m/s" if self.unit == 1 else "v0"

    def table(self, ordered: Array, ensembles: Sequence[Ensemble]) -> str:
        """Return the values at the last sample and the averages over random chains as text.

        Parameters
        ----------
        ordered : (N,) array
            Velocity of every grain of the ordered linear chain at the same time, m/s.
        ensembles : M of Ensemble
            Averages over random chains for each m, whose last sample is at the same time.
        """
        unit = "m/s" if self.unit == 1 else f"v0 = {self.unit:g} m/s"
        lines = wrap(
            f"t = {self.time[-1]:.6g} s (tau = {self.tau[-1]:.4g}); velocities in {unit}",
            f"Eq. (22): {MEANING}",
            f"random chains: largest mean velocity over {ensembles[0].realisations} linear chains "
            "with kappa_n zeta_n, its standard error and grain",
        )
        equation = ["as printed", "sum of weights", "normalised"]
        rows = [["m", *equation, "random chains", "standard error", "grain"]]
        for row in self._rows(ensembles):
            mean = row["random_chains"]
            values = [row[key] for key in ("as_printed", "weights", "normalised")]
            values += [mean["largest"], mean["standard_error"]]
            texts = [number(value, ".5g") for value in values]
            rows.append([f"{row['m']:g}", *texts, str(mean["grain"])])
        peak = int(np.abs(ordered).argmax())
        velocity = number(ordered[peak] / self.unit, ".5g")
        rows.append(["ordered", "", "", "", velocity, "", str(peak + 1)])
        lines += align(rows)
        largest = max(ensemble.model_error for ensemble in ensembles)
        lines.append(f"model error of Eq. (3) in random chains: up to {largest:.2g}")
        if squeezed := sum(ensemble.squeezed for ensemble in ensembles):
            lines += wrap(
                f"in {counted(squeezed, 'chain')} a contact is so soft that Hertz's law would no "
                "longer hold at rest"
            )
        return "\n".join(lines)

    def to_json(self, ordered: Array, ensembles: Sequence[Ensemble]) -> dict[str, Any]:
        """Return the numbers of the table and its curves; see `table` for the arguments."""
        rows = self._rows(ensembles)
        for row, printed, normalised, ensemble in zip(
            rows, self.as_printed, self.normalised, ensembles, strict=True
        ):
            row["as_printed_over_time"] = (printed / self.unit).tolist()
            row["normalised_over_time"] = (normalised / self.unit).tolist()
            row["random_chains"] |= {
                "mean_velocity": (ensemble.velocity[-1] / self.unit).tolist(),
                "standard_errors": (ensemble.velocity_error[-1] / abs(self.unit)).tolist(),
            }
        return {
            "what": f"Eq. (22) is {MEANING}",
            "velocity_unit_m_per_s": self.unit,
            "time_s": self.time.tolist(),
            "tau": self.tau.tolist(),
            "kappa": self.kappa.tolist(),
            "ordered_velocity": (ordered / self.unit).tolist(),
            "realisations": ensembles[0].realisations,
            "seed": ensembles[0].seed,
            "rows": rows,
        }

    def _rows(self, ensembles: Sequence[Ensemble]) -> list[dict[str, Any]]:
        """Return the rows of the table for the last sample, in the displayed unit."""
        rows = []
        for row, (m, ensemble) in enumerate(zip(self.m, ensembles, strict=True)):
            peak = int(np.abs(ensemble.velocity[-1]).argmax())
            rows.append(
                {
                    "m": float(m),
                    "as_printed": float(self.as_printed[row, -1] / self.unit),
                    "weights": float(self.weight[row].sum()),
                    "normalised": float(self.normalised[row, -1] / self.unit),
                    "random_chains": {
                        "largest": float(ensemble.velocity[-1, peak] / self.unit),
                        "standard_error": float(ensemble.velocity_error[-1, peak] / abs(self.unit)),
                        "grain": int(ensemble.grains[peak]),
                        "model_error": ensemble.model_error,
                        "squeezed_chains": ensemble.squeezed,
                    },
                }
            )
        return rows

    def plot(
        self, ordered: Array, ensembles: Sequence[Ensemble], ax: Axes | Sequence[Axes] | None = None
    ) -> Axes:
        """Draw means over random chains and the terms of Eq. (22) over grains at the last sample.

        Parameters
        ----------
        ordered, ensembles
            See `table`.
        ax : axes, or two of them, optional
            Axes of the means, or of the means and the terms; by default both in a new figure.

        Returns
        -------
        Axes
            Axes of the means.
        """
        own = window(PRINTED_WIDTH, 8.0).subplots(2, sharex=True) if ax is None else []
        means, *terms_axes = panels(own if ax is None else ax)
        colours = list(COLOURS.values())
        grains = np.arange(1, ordered.size + 1)
        means.plot(grains, ordered / self.unit, color="black", lw=2.2, alpha=0.6, label="ordered")
        for row, (m, ensemble) in enumerate(zip(self.m, ensembles, strict=True)):
            # Colours repeat before dashes do, so that no two lines look alike.
            dash = DASHES[(row + row // len(colours)) % len(DASHES)]
            style: dict[str, Any] = {"color": colours[row % len(colours)], "ls": dash, "lw": 1.6}
            mean = ensemble.velocity[-1] / self.unit
            band = 2 * ensemble.velocity_error[-1] / abs(self.unit)
            means.plot(ensemble.grains, mean, label=f"m = {m:g}", **style)
            low = mean - band
            high = mean + band
            colour = style["color"]
            means.fill_between(ensemble.grains, low, high, color=colour, alpha=0.2, lw=0)
            terms = self.weight[row] * self.velocity[-1] / self.unit
            total = self.as_printed[row, -1] / self.unit
            for ax in terms_axes:
                ax.plot(grains, terms, label=f"m = {m:g}: sum {total:.4g}", **style)
        unit = r"$v_0$" if self.unit != 1 else "m/s"
        means.set_ylabel(f"mean velocity ({unit})")
        set_title(
            means,
            f"Mean over {ensembles[0].realisations} random linear chains, ± 2 standard errors",
        )
        for ax in terms_axes:
            ax.set_ylabel(rf"$D_m(\kappa_n)\,\dot\varphi_n$ ({unit})")
            title = "Terms of Eq. (22), one chain weighted over depth"
            set_title(ax, f"{title}, tau = {self.tau[-1]:.4g}")
        largest = np.abs([ordered, self.velocity[-1]]).max(0)
        moving = np.flatnonzero(largest > 1e-3 * largest.max())
        # Show a few grains at rest below the wave.
        last = int(moving[-1]) + 5 if moving.size else grains.size
        for panel in (means, *terms_axes):
            panel.set_xlim(0.5, min(last, grains.size) + 0.5)
            panel.axhline(0, color="0.8", lw=0.8, zorder=0)
            legend(panel)
        panel.set_xlabel("grain number n, from the top")
        letter_panels(own)
        return means

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        yield from number_columns("as_printed", "m/s", self.m, self.as_printed.T)
        yield from number_columns("normalised", "m/s", self.m, self.normalised.T)


def sums(trajectory: Trajectory, m: Sequence[float]) -> DysonSums:
    """Return Eq. (22) of a trajectory for some orders m.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine, in which all grains that move were recorded.
    m : (M,) array_like
        Orders, all above 0.

    Returns
    -------
    DysonSums

    Raises
    ------
    InputError
        If m is not above 0, a grain that moves was not recorded, or the chain is a sonic vacuum,
        where no contact has a stiffness at rest.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=60, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-12)
    >>> duration = 15 * chain.time_scale
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=duration, samples=2)
    >>> run = lmpchain.simulate(scene, engine="modes")
    >>> print(sums(run, [1, 5]).as_printed[:, -1].round(16) / 1e-12)
    [ 0.1523 -0.0241]
    """
    chain = trajectory.scene.chain
    kappa = relative_stiffness(chain)
    _, velocity = motion(trajectory, np.arange(1, chain.grains + 1))
    orders = numbers(m, "m")
    weight = dyson.weight(kappa, orders[:, None])
    return DysonSums(
        m=orders,
        time=trajectory.time,
        tau=trajectory.time / chain.time_scale,
        kappa=kappa,
        velocity=velocity,
        weight=weight,
        as_printed=dyson.average(velocity, kappa, orders[:, None]),
        normalised=dyson.average(velocity, kappa, orders[:, None], normalised=True),
        unit=trajectory.scene.strike_velocity or 1.0,
    )


def orders(text: str) -> list[float]:
    """Return the numbers of a list such as 1,2,5,20; raise `InputError` unless all are above 0.

    Parameters
    ----------
    text : str

    Returns
    -------
    list of float

    Raises
    ------
    InputError
        If an entry is not a number above 0.

    Examples
    --------
    >>> orders("1, 2.5")
    [1.0, 2.5]
    """
    values = []
    for word in dict.fromkeys(word.strip() for word in text.split(",")):
        try:
            values.append(float(word))
        except ValueError:
            raise InputError.at(
                "m", f"must be numbers separated by commas (got {shown(word)})"
            ) from None
    if wrong := [m for m in values if not 0 < m < np.inf]:
        raise InputError.at("m", f"must be above 0 (got {wrong[0]:g})")
    return values


def relative_stiffness(chain: Chain) -> Array:
    """Return the stiffness of the contact below each grain relative to the first contact, (N,).

    In a uniform column under gravity, contact n has the relative stiffness n^(1 - 1/delta). Without
    a wall below, grain N is given a contact like the one above it, which also carries its weight.

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    (N,) array

    Raises
    ------
    InputError
        If the chain is a sonic vacuum.

    Examples
    --------
    >>> kappa = relative_stiffness(Chain(grains=60, diameter=1e-3))
    >>> bool(abs(kappa - np.arange(1, 61) ** (1 / 3)).max() < 1e-14)
    True
    """
    chain.refuse_ground("relative stiffness")
    if not chain.compressed:
        raise InputError.at(
            "gravity",
            "without gravity and load, contacts have no stiffness at rest, so that kappa_n is "
            "undefined: add either",
        )
    chain.refuse_loose("relative stiffness")
    stiffness = chain.contacts.stiffness[1:].copy()
    contacts = chain.contacts
    if chain.bottom != "wall":
        weight = chain.gravity * chain.masses[-1]
        # The last contact would carry the weight of one additional grain.
        above = contacts.constant[-2], contacts.force[-2] + weight
        stiffness[-1] = Contacts.at_rest(*above, contacts.law).stiffness
    return stiffness / stiffness[0]
