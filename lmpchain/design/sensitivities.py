"""Sensitivity of a result to every grain, and its uncertainty for uncertain grains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np

from ..errors import InputError, RunFailed, not_among, shown
from ..integrators.differentiation import DIFFERENTIABLE
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.plotting import COLOURS, Axes, chart, finish, prefixed
from ..util.tabular import NamedColumn, Tabular
from . import parameters as params
from .gradients import Gradient, at_step, gradient, shortens
from .objectives import ArrivalTime, Energy, KineticEnergy, Momentum, Objective, PeakForce
from .parameters import changed

ROWS = 12  # Number of rows of a table.
# Number of pairs of random chains; the scatter is some 5 % off if the result is far from linear.
PAIRS = 16
# Values below this one (SI units) count as 0. Momentum and energy far ahead of a wave may be
# smaller, because they decay faster than any power.
NO_INFLUENCE = 1e-150
REST_ROUNDING = 1e-9  # Relative rounding of a force at rest.
# Order of a table: properties of the chain, then loads and excitation.
CANDIDATES = (
    "diameters",
    "youngs_modulus",
    "masses",
    "contact_constants",
    "wall_constants",
    "top_load",
    "gravity",
    params.VISCOSITY,
    params.DRAG,
    "velocity",
    "displacement",
    "drive",
    "force",
    "amplitude",
    "frequency",
)
# Parameters that replace diameters and moduli if they are given.
OVERRIDES = ("masses", "contact_constants", "wall_constants")
UNITS = {
    "peak_force": "N",
    "energy": "J",
    "kinetic_energy": "J",
    "momentum": "kg m/s",
    "arrival_time": "s",
}
FORMS = {"peak_force": "peak_force:CONTACT", "arrival_time": "arrival_time:GRAIN@VELOCITY"}
GROUPS: dict[str, type[Energy | KineticEnergy | Momentum]] = {
    "energy": Energy,
    "kinetic_energy": KineticEnergy,
    "momentum": Momentum,
}


@dataclass(frozen=True, eq=False)
class Sensitivity(Tabular):
    """Changes of a result with every parameter that it depends on.

    Attributes
    ----------
    of, unit : str
        Name of the result; unit of the result.
    gradient : Gradient
        The result and its derivatives, with errors.
    relative : dict
        Change of the result for a relative change of each entry, by parameter name, in the unit of
        the result.
    uncertainty : dict
        Standard deviation of the result to first order, due to each uncertain parameter, by name.
    deviation : float
        Standard deviation of the result to first order, due to all uncertain parameters.
    scatter, shift : float
        Standard deviation of the result beyond first order; mean change of the result. Both follow
        from `PAIRS` pairs of random chains that differ from the scene by opposite amounts, and are
        NaN if a chain has no such result.
    remark : str
        Remark if no wave reaches the grains of the result; otherwise empty.
    """

    of: str
    unit: str
    gradient: Gradient
    relative: dict[str, Array]
    uncertainty: dict[str, float]
    scatter: float
    shift: float
    remark: str = ""

    @property
    def value(self) -> float:
        """Value of the result in the given scene."""
        return self.gradient.value

    @property
    def deviation(self) -> float:
        """Standard deviation of the result, to first order."""
        return float(np.sqrt(sum(deviation**2 for deviation in self.uncertainty.values())))

    def ranked(self) -> list[tuple[str, float]]:
        """Return every entry with its change for 1 %, largest change first."""
        entries = [
            (name if change.size == 1 else f"{name} {number}", float(entry) / 100)
            for name, change in self.relative.items()
            for number, entry in enumerate(change, 1)
        ]
        return sorted(entries, key=lambda row: -abs(row[1]))

    def table(self) -> str:
        """Return the result, its largest changes and its uncertainty as text."""
        from ..util.tables import align

        size = abs(self.value) or 1.0
        error = self.gradient.value_error
        remarks = [self.remark] if self.remark else []
        lines = [f"{self.of}: {self.value:.8g} {self.unit} (error {error:.1e})", *remarks, ""]
        rows = [("for 1 % more", f"{self.unit}", "%")]
        for name, change in self.ranked()[:ROWS]:
            rows.append((name, f"{change:+.4g}", f"{100 * change / size:+.4f}"))
        for name, changes in self.relative.items():
            if changes.size > 1:
                total = changes.sum()
                rows.append((f"all {name}", f"{total / 100:+.4g}", f"{total / size:+.4f}"))
        lines += [*align(rows), f"relative error of the derivatives: {self.gradient.error:.1e}"]
        for name, deviation in self.uncertainty.items():
            lines.append(f"by the uncertainty of {name}: {deviation:.3g} {self.unit}")
        if self.uncertainty:
            percent = 100 * self.deviation / size
            first = f"{self.deviation:.3g} {self.unit} ({percent:.2g} %)"
            lines.append(f"uncertainty to first order: {first}")
            beyond = "beyond first order: unknown, because some random chains have no value"
            if np.isfinite(self.scatter):
                scatter = f"{self.scatter:.3g} {self.unit}"
                shift = f"the mean shifted by {self.shift:+.2g}"
                beyond = f"by {2 * PAIRS} random chains: {scatter}, {shift}"
            lines.append(beyond)
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return all numbers for JSON."""
        return {
            "of": self.of,
            "unit": self.unit,
            "value": self.value,
            "value_error": self.gradient.value_error,
            "derivatives": {name: slope.tolist() for name, slope in self.gradient.items()},
            "derivative_errors": dict(self.gradient.errors),
            "per_relative_change": {name: x.tolist() for name, x in self.relative.items()},
            "uncertainty": self.uncertainty | {"all": self.deviation},
            "scatter": self.scatter,
            "shift": self.shift,
            "remark": self.remark,
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the change for 1 % of every entry along the chain, and return the axes."""
        ax = chart(ax, "grain", "change for 1 % more, %")
        size = abs(self.value) or 1.0
        last = 0
        colours = cycle(COLOURS.values())
        for name, change in self.relative.items():
            if change.size <= 2:
                continue
            # A contact is drawn between its two grains.
            at = np.arange(1, change.size + 1) + (0.5 if name == "contact_constants" else 0.0)
            label = name.replace("_", " ").replace("youngs", "Young's")
            line: dict[str, Any] = {"color": next(colours), "marker": ".", "ms": 3, "lw": 0.9}
            ax.plot(at, change / size, label=label, **line)
            # Smaller changes are invisible in the picture.
            last = max(last, *np.flatnonzero(abs(change) > 1e-3 * abs(change).max()), 0)
        ax.axhline(0, color="0.6", lw=0.6, zorder=0)
        ax.set_xlim(0.5, last + 2.5)
        kind, _, place = self.of.replace("_", " ").partition(":")
        where = "contact" if kind == "peak force" else "grain"
        name = f"{kind}, {where} {place}" if place else kind
        return finish(ax, f"{name}: {prefixed(self.value, self.unit)}")

    def _columns(self) -> Iterator[NamedColumn]:
        names, changes = zip(*self.ranked(), strict=True)
        yield NamedColumn("parameter", "", list(names))
        yield NamedColumn("change", self.unit, np.array(changes))


def objective(of: str) -> tuple[Objective, str]:
    """Return the objective that a text such as peak_force:40 describes, and its unit.

    Examples
    --------
    >>> objective("kinetic_energy:3-5")
    (KineticEnergy(group=[3, 4, 5], time=None), 'J')
    """
    kind, _, argument = of.partition(":")
    if kind not in UNITS:
        raise InputError.at("of", not_among(kind, tuple(UNITS)))
    form = FORMS.get(kind, f"{kind}:GRAIN or {kind}:FIRST-LAST")
    wrong = InputError.at("of", f"must be {form} (got {shown(of)})")
    try:
        if kind == "peak_force":
            return PeakForce(int(argument)), UNITS[kind]
        if kind == "arrival_time":
            grain, _, velocity = argument.partition("@")
            return ArrivalTime(int(grain), float(velocity)), UNITS[kind]
        first, dash, last = argument.partition("-")
        group = list(range(int(first), int(last if dash else first) + 1))
    except ValueError as error:
        raise wrong from error
    if not group:
        raise wrong
    return GROUPS[kind](group), UNITS[kind]


def _parameters(scene: Scene) -> list[str]:
    """Return the parameters of a result: diameters and moduli, or the ones given instead."""
    fields = scene.chain.given().keys()
    derived = not {"masses", "contact_constants"} <= fields
    names = []
    for name in (*CANDIDATES, *params.names_of_formulas(scene.chain)):
        if name in OVERRIDES and name not in fields:
            continue
        # Diameters and moduli have no effect if masses and constants are given.
        if name in ("diameters", "youngs_modulus") and not derived:
            continue
        try:
            params.check(scene, [name])
        except InputError:
            continue
        # A parameter of value 0 has no relative change.
        if params.values(scene, name).any():
            names.append(name)
    return names


def sensitivity(
    scene: Scene,
    of: str | Objective,
    uncertain: Mapping[str, float] | None = None,
    tolerance: float = 1e-4,
) -> Sensitivity:
    """Return the changes of a result with every grain and with the excitation.

    Parameters
    ----------
    scene : Scene
    of : str or Objective
        Result: "peak_force:CONTACT", "energy:FIRST-LAST", "kinetic_energy:FIRST-LAST",
        "momentum:GRAIN", "arrival_time:GRAIN@VELOCITY", or an objective.
    uncertain : mapping, optional
        Relative standard deviation of every entry of a parameter, by parameter name, such as
        "diameters".
    tolerance : float
        Largest relative error of the derivatives.

    Returns
    -------
    Sensitivity
        The `relative` changes and the `uncertainty`, with `table` and `plot`.

    Raises
    ------
    InputError
        If there is no such result or parameter, or if a relative deviation is not from 0 to 1.
    ToleranceNotMet
        As for `gradient`.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> chain = Chain(grains=10, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=2e-5, samples=21)
    >>> force = sensitivity(scene, "peak_force:5", {"diameters": 0.01})
    >>> force.deviation < 0.05 * force.value
    True
    """
    answer, unit = objective(of) if isinstance(of, str) else (of, "")
    names = _parameters(scene)
    if not isinstance(uncertain, Mapping | None):
        message = f"must be uncertainties by parameter name (got {shown(uncertain)})"
        raise InputError.at("uncertain", message)
    uncertain = dict(uncertain or {})
    for name, share in uncertain.items():
        if name not in names:
            raise InputError.at("uncertain", not_among(name, tuple(names)))
        number = isinstance(share, int | float | np.number) and not isinstance(share, bool)
        if not number or not 0 <= share < 1:
            message = f"must be from 0 to 1, relative to each entry (got {shown(share)})"
            raise InputError.at(name, message)
    slopes = gradient(scene, answer, names, tolerance)
    relative = {name: slopes[name] * params.values(scene, name) for name in names}
    deviations = {
        name: float(share * np.sqrt((relative[name] ** 2).sum()))
        for name, share in uncertain.items()
    }
    scatter, shift = _draw_pairs(scene, answer, slopes, relative, uncertain)
    name = of if isinstance(of, str) else repr(of)
    remark = _remark(scene, answer, slopes.value)
    return Sensitivity(name, unit, slopes, relative, deviations, scatter, shift, remark)


def _remark(scene: Scene, answer: Objective, value: float) -> str:
    """Return a remark if no wave reaches the grains of a result, otherwise an empty text."""
    within = f"within {scene.duration:g} s: use a longer duration"
    if isinstance(answer, PeakForce):
        rest = float(scene.chain.contacts.force[answer.contact])
        at_rest = abs(value - rest) <= REST_ROUNDING * rest
        words = f"no wave reaches contact {answer.contact} {within}; this is its force at rest"
        return words if at_rest else ""
    return f"no wave reaches these grains {within}" if abs(value) < NO_INFLUENCE else ""


def _draw_pairs(
    scene: Scene,
    answer: Objective,
    slopes: Gradient,
    relative: Mapping[str, Array],
    uncertain: Mapping[str, float],
) -> tuple[float, float]:
    """Return the standard deviation and mean change of a result beyond first order.

    The two chains of a pair differ from the scene by opposite amounts. The odd part of their
    changes, divided by the linear change, corrects the standard deviation of first order; the even
    part adds to it.
    """
    first = sum(
        float((share * relative[name]) @ (share * relative[name]))
        for name, share in uncertain.items()
    )
    if first == 0:
        return 0.0, 0.0
    # Every call uses the same random chains, so that results can be compared.
    rng = np.random.default_rng(0)
    method = DIFFERENTIABLE[slopes.integrator]
    adaptive = shortens(scene, method)

    def value(changes: Mapping[str, Array], side: int) -> float:
        drawn = {
            name: params.values(scene, name) * (1 + side * change)
            for name, change in changes.items()
        }
        drawn_scene = changed(scene, drawn)
        return at_step(drawn_scene, answer, (), method, slopes.step_s, adaptive).value

    linear, odd, even = np.zeros((3, PAIRS))
    try:
        for pair in range(PAIRS):
            changes = {
                name: share * rng.standard_normal(relative[name].size)
                for name, share in uncertain.items()
            }
            up = value(changes, 1)
            down = value(changes, -1)
            linear[pair] = sum(relative[name] @ change for name, change in changes.items())
            odd[pair] = (up - down) / 2
            even[pair] = (up + down) / 2 - slopes.value
    except (InputError, RunFailed):
        return float("nan"), float("nan")
    scatter = np.sqrt(first * (odd @ odd) / (linear @ linear) + even.var(ddof=1))
    return float(scatter), float(even.mean())
