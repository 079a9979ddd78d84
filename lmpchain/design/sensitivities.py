"""What an answer depends on, grain by grain, and how uncertain it is for uncertain grains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, RunFailed, shown
from ..integrators.splittings import SPLITTINGS
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.suggestions import not_among
from . import parameters as params
from .changes import changed
from .gradients import Gradient, at_step, gradient
from .objectives import ArrivalTime, Energy, KineticEnergy, Momentum, Objective, PeakForce

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROWS = 12  # of a table
PAIRS = 16  # of drawn chains: by some 5 % off where an answer is well beyond first order
CANDIDATES = (
    "diameters", "youngs_moduli", "masses", "contact_constants", "wall_constants", "top_load", "gravity", "velocity",
    "displacement", "drive", "force", "amplitude", "frequency",
)  # fmt: skip
OVERRIDES = ("masses", "contact_constants", "wall_constants")  # looked at where they are given
UNITS = {
    "peak_force": "N",
    "energy": "J",
    "kinetic_energy": "J",
    "momentum": "kg m/s",
    "arrival_time": "s",
}
GROUPS: dict[str, type[Energy | KineticEnergy | Momentum]] = {
    "energy": Energy,
    "kinetic_energy": KineticEnergy,
    "momentum": Momentum,
}


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """How an answer changes with everything that it depends on.

    Attributes
    ----------
    of, unit : str
        What was asked for, and its unit.
    gradient : Gradient
        The answer and its derivatives, with errors.
    relative : dict
        By name, the change of the answer for a relative change of each entry, in the unit of the answer.
    uncertainty : dict
        By name, the standard deviation to first order that the given uncertainties of its entries make on their own.
    deviation : float
        Standard deviation of the answer by all of them, to first order.
    scatter, shift : float
        Standard deviation and mean change of the answer beyond first order, by `PAIRS` pairs of drawn chains that
        differ from the scene by as much to either side; NaN where one of them has no such answer.
    """

    of: str
    unit: str
    gradient: Gradient
    relative: dict[str, Array]
    uncertainty: dict[str, float]
    scatter: float
    shift: float

    @property
    def value(self) -> float:
        """The answer."""
        return self.gradient.value

    @property
    def deviation(self) -> float:
        """Standard deviation of the answer, to first order."""
        return float(np.sqrt(sum(part**2 for part in self.uncertainty.values())))

    def ranked(self) -> list[tuple[str, float]]:
        """Return every entry and its change for 1 %, the largest first."""
        every = [
            (name if change.size == 1 else f"{name} {entry}", float(part) / 100)
            for name, change in self.relative.items()
            for entry, part in enumerate(change, 1)
        ]
        return sorted(every, key=lambda row: -abs(row[1]))

    def table(self) -> str:
        """Return the answer, what matters most, and the uncertainty, as text."""
        from ..util.tables import align

        size = abs(self.value) or 1.0
        lines = [
            f"{self.of}: {self.value:.8g} {self.unit} (error {self.gradient.value_error:.1e})",
            "",
        ]
        rows = [("for 1 % more", f"{self.unit}", "%")]
        rows += [
            (name, f"{part:+.4g}", f"{100 * part / size:+.4f}")
            for name, part in self.ranked()[:ROWS]
        ]
        rows += [
            (f"all {name}", f"{part.sum() / 100:+.4g}", f"{part.sum() / size:+.4f}")
            for name, part in self.relative.items()
            if part.size > 1
        ]
        lines += [*align(rows), f"derivatives known to {self.gradient.error:.1e}"]
        for name, part in self.uncertainty.items():
            lines.append(f"by the uncertainty of {name}: {part:.3g} {self.unit}")
        if self.uncertainty:
            lines.append(
                f"uncertainty to first order: {self.deviation:.3g} {self.unit} ({100 * self.deviation / size:.2g} %)"
            )
            lines.append(
                f"by {2 * PAIRS} drawn chains: {self.scatter:.3g} {self.unit}, the mean shifted by {self.shift:+.2g}"
                if np.isfinite(self.scatter)
                else "beyond first order: unknown, as not every drawn chain has an answer"
            )
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return all numbers for JSON."""
        return {
            "of": self.of, "unit": self.unit, "value": self.value, "value_error": self.gradient.value_error,
            "derivatives": {name: part.tolist() for name, part in self.gradient.items()},
            "derivative_errors": dict(self.gradient.errors),
            "per_relative_change": {name: part.tolist() for name, part in self.relative.items()},
            "uncertainty": self.uncertainty | {"all": self.deviation},
            "scatter": self.scatter, "shift": self.shift,
        }  # fmt: skip

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the change for 1 % of every entry along the chain; returns the axes."""
        from ..util.plotting import COLOURS, axes_in_units, legend, set_title

        ax = axes_in_units(ax, "", "")
        size = abs(self.value) or 1.0
        drawn = [(name, part) for name, part in self.relative.items() if part.size > 2]
        matters = np.concatenate(
            [np.flatnonzero(abs(part) > 1e-3 * abs(part).max()) for _, part in drawn]
            or [np.zeros(1, int)]
        )
        for (name, part), colour in zip(drawn, COLOURS.values(), strict=False):
            at = np.arange(1, part.size + 1) + (0.5 if name == "contact_constants" else 0.0)
            ax.plot(
                at,
                part / size,
                color=colour,
                label=name.replace("_", " "),
                marker=".",
                ms=3,
                lw=0.9,
            )
        ax.axhline(0, color="0.6", lw=0.6, zorder=0)
        ax.set_xlabel("grain")
        ax.set_ylabel("change for 1 % more, %")
        ax.set_xlim(0.5, matters.max() + 2.5)
        set_title(ax, f"{self.of.replace('_', ' ')}: {self.value:.6g} {self.unit}")
        legend(ax)
        return ax


def objective(of: str) -> tuple[Objective, str]:
    """Return the objective that a text such as peak_force:40 names, and its unit.

    Examples
    --------
    >>> objective("kinetic_energy:3-5")
    (KineticEnergy(group=[3, 4, 5], time=None), 'J')
    """
    kind, _, where = of.partition(":")
    if kind not in UNITS:
        raise InputError([("of", not_among(kind, tuple(UNITS)))])
    forms = {"peak_force": "peak_force:CONTACT", "arrival_time": "arrival_time:GRAIN@VELOCITY"}
    wrong = InputError(
        [
            (
                "of",
                f"must be {forms.get(kind, f'{kind}:GRAIN or {kind}:FIRST-LAST')} (got {shown(of)})",
            )
        ]
    )
    try:
        if kind == "peak_force":
            return PeakForce(int(where)), UNITS[kind]
        if kind == "arrival_time":
            grain, _, velocity = where.partition("@")
            return ArrivalTime(int(grain), float(velocity)), UNITS[kind]
        first, dash, last = where.partition("-")
        group = list(range(int(first), int(last if dash else first) + 1))
    except ValueError as error:
        raise wrong from error
    if not group:
        raise wrong
    return GROUPS[kind](group), UNITS[kind]


def _depends_on(scene: Scene) -> list[str]:
    """Return what the answer depends on: diameters and moduli, or what is given in their place."""
    given, names = scene.chain.given().keys(), []
    for name in CANDIDATES:
        if name in OVERRIDES and name not in given:
            continue
        if name in ("diameters", "youngs_moduli") and {"masses", "contact_constants"} <= given:
            continue
        try:
            params.check(scene, [name])
        except InputError:
            continue
        if params.values(scene, name).any():
            names.append(name)
    return names


def sensitivity(
    scene: Scene,
    of: str | Objective,
    uncertain: Mapping[str, float] | None = None,
    tolerance: float = 1e-4,
) -> Sensitivity:
    """Return how an answer changes with every grain and with what sets the chain in motion.

    Parameters
    ----------
    scene : Scene
    of : str or Objective
        "peak_force:CONTACT", "energy:FIRST-LAST", "kinetic_energy:FIRST-LAST", "momentum:GRAIN",
        "arrival_time:GRAIN@VELOCITY".
    uncertain : mapping, optional
        By name of a parameter, such as "diameters", the relative standard deviation of every entry.
    tolerance : float
        Of the derivatives.

    Returns
    -------
    Sensitivity
        Its `table`, `plot`, `relative` changes and `uncertainty`.

    Raises
    ------
    InputError
        If there is no such answer, or a parameter or its deviation is none.
    ToleranceNotMet
        As `gradient`.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> chain = Chain(grains=10, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=2e-5, samples=21)
    >>> found = sensitivity(scene, "peak_force:5", {"diameters": 0.01})
    >>> found.deviation < 0.05 * found.value
    True
    """
    wanted, unit = objective(of) if isinstance(of, str) else (of, "")
    names = _depends_on(scene)
    uncertain = dict(uncertain or {})
    for name, share in uncertain.items():
        if name not in names:
            raise InputError([("uncertain", not_among(name, tuple(names)))])
        if not 0 <= share < 1:
            raise InputError(
                [(name, f"must be from 0 to 1, a part of each entry (got {shown(share)})")]
            )
    found = gradient(scene, wanted, names, tolerance)
    relative = {name: found[name] * params.values(scene, name) for name in names}
    deviations = {
        name: float(share * np.sqrt((relative[name] ** 2).sum()))
        for name, share in uncertain.items()
    }
    beyond = _beyond_first_order(scene, wanted, found, relative, uncertain)
    return Sensitivity(
        of if isinstance(of, str) else repr(of), unit, found, relative, deviations, *beyond
    )


def _beyond_first_order(
    scene: Scene,
    wanted: Objective,
    found: Gradient,
    relative: Mapping[str, Array],
    uncertain: Mapping[str, float],
) -> tuple[float, float]:
    """Return standard deviation and mean change of the answer, by pairs of drawn chains.

    The two differ from the scene by as much, to either side.
    What is odd in the changes, over what is linear in them, corrects the first order; what is even adds to it.
    """
    first = float(
        sum(
            (share * relative[name]) @ (share * relative[name]) for name, share in uncertain.items()
        )
    )
    if first == 0:
        return 0.0, 0.0
    rng, method = np.random.default_rng(0), SPLITTINGS[found.integrator]
    linear, odd, even = np.zeros((3, PAIRS))
    try:
        for pair in range(PAIRS):
            changes = {
                name: share * rng.standard_normal(relative[name].size)
                for name, share in uncertain.items()
            }
            up, down = (
                at_step(
                    changed(scene, {name: params.values(scene, name) * (1 + side * change)
                                    for name, change in changes.items()}),
                    wanted, (), method, found.step_s,
                )[0]
                for side in (1, -1)
            )  # fmt: skip
            linear[pair] = sum(relative[name] @ change for name, change in changes.items())
            odd[pair], even[pair] = (up - down) / 2, (up + down) / 2 - found.value
    except (InputError, RunFailed):
        return float("nan"), float("nan")
    return float(np.sqrt(first * (odd @ odd) / (linear @ linear) + even.var(ddof=1))), float(
        even.mean()
    )
