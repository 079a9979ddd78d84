"""Unknowns of a fit as relative changes, and the residuals of the traces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..engines.stepping.rounding import native_floor
from ..errors import InputError, RunFailed, shown
from ..integrators.adjoint import Inputs
from ..integrators.differentiation import AnyMethod, differentiable, method_for
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.units import FIELD_UNITS
from . import parameters as params
from .differences import FixedRun, differentiate, first_looks, size_by_force
from .parameters import changed
from .traces import Traces, model

# Relative error of a Jacobian by differences; the estimates of a fit do not depend on it.
ACCURACY = 1e-5
# Parameters that may change sign; all others stay above a tenth of their value.
SIGNED = ("displacement", "velocity", "drive", "force", "amplitude")
LOWEST = -0.9
# Smallest relative change of parameters that may vanish.
NOTHING = -1.0
MAY_VANISH = (params.VISCOSITY, params.DRAG)


def _entries(name: str, choice: Any, size: int) -> list[int]:
    """Return the numbers of the entries that are unknown; raise `InputError` if they are none."""
    if isinstance(choice, str) and choice == "each":
        return list(range(1, size + 1))
    chosen = isinstance(choice, Iterable) and not isinstance(choice, str)
    entries = list(choice) if chosen else []
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in entries)
    if not chosen or not whole or not all(1 <= number <= size for number in entries):
        message = f'must be "common", "each" or numbers from 1 to {size}'
        raise InputError.at(name, f"{message} (got {shown(choice)})")
    return [int(number) for number in entries]


class Problem:
    """The unknowns of a fit, as K relative changes `theta`, and the residuals of the traces.

    Attributes
    ----------
    names : list of str
        Names of the unknowns: parameters of the scene, then nuisance parameters of the traces.
    units, origin : lists of float
        Scale and origin of the estimates, which are origin + units theta.
    symbols : list of str
        Units of the estimates as text; empty for a factor or a gain.
    along : list
        Name and direction, in the unit of the parameter, of every unknown of the scene.
    looks : int
        Number of evaluation times of a run, with a step of rkn4 each.
    variance : float
        Variance of the residuals, if the traces have no given noise.
    """

    def __init__(self, scene: Scene, traces: Sequence[Traces], parameters: Mapping[str, Any]):
        self.scene = scene
        self.traces = traces
        self.variance = 1.0
        self.names: list[str] = []
        self.units: list[float] = []
        self.origin: list[float] = []
        self.symbols: list[str] = []
        self.along: list[tuple[str, Array]] = []
        for name in params.check(scene, parameters):
            self._add_parameter(name, params.values(scene, name), parameters[name])
        for number, trace in enumerate(traces, 1):
            self._add_nuisances(trace, f" {number}" if len(traces) > 1 else "")
        self.looks = first_looks(scene)
        self.grains = np.unique(np.concatenate([trace.grains(scene) for trace in traces]))

    @property
    def noisy(self) -> bool:
        """Whether the noise level of every trace is given."""
        return all(trace.noise is not None for trace in self.traces)

    def _add(self, name: str, origin: float, unit: float, symbol: str) -> None:
        self.names.append(name)
        self.origin.append(origin)
        self.units.append(unit)
        self.symbols.append(symbol)

    def _add_nuisances(self, trace: Traces, suffix: str) -> None:
        """Add strike time, gain and offsets of a trace to the unknowns if they are not known."""
        if trace.trigger:
            self._add("trigger" + suffix, 0.0, trace.time[-1] - trace.time[0], "s")
        if trace.gain:
            self._add("gain" + suffix, 1.0, 1.0, "")
        if trace.offset:
            size = float(np.abs(trace.values).max()) or 1.0
            for place in trace.places:
                self._add(f"offset{suffix} {place}", 0.0, size, FIELD_UNITS[trace.field])

    def _add_parameter(self, name: str, base: Array, choice: Any) -> None:
        """Add a parameter: one factor for all entries, or single entries."""
        symbol = params.unit(self.scene, name)
        largest = float(np.abs(base).max())
        if largest == 0 and name.startswith("chain."):
            largest = size_by_force(self.scene, name)
        if isinstance(choice, str) and choice == "common":
            self._add_common(name, base, largest, symbol)
            return
        for number in _entries(name, choice, base.size):
            # The unit of an entry of 0 is the largest entry.
            unit = float(base[number - 1]) or largest or 1.0
            self._add(f"{name} {number}", float(base[number - 1]), unit, symbol)
            self.along.append((name, unit * (np.arange(base.size) == number - 1)))

    def _add_common(self, name: str, base: Array, largest: float, symbol: str) -> None:
        """Add one factor for all entries, or one change of the size `largest` if they are 0."""
        if largest == 0:
            cure = "start from a guess above 0" if name in MAY_VANISH else "name entries"
            raise InputError.at(name, f"is 0 everywhere, so a factor cannot change it: {cure}")
        if not base.any():
            self._add(name, 0.0, largest, symbol)
            self.along.append((name, np.full(base.size, largest)))
            return
        entries = base[base != 0]
        # Equal entries are estimated in their own unit, unequal entries by a factor.
        alike = bool((entries == entries[0]).all())
        unit = float(entries[0]) if alike else 1.0
        self._add(name, unit, unit, symbol if alike else "")
        self.along.append((name, base))

    def estimates(self, theta: Array) -> Array:
        """Return the unknowns in their units."""
        return np.array(self.origin) + np.array(self.units) * theta

    def free(self, estimate: Array) -> Array:
        """Return the relative changes for given values of the unknowns."""
        return (estimate - np.array(self.origin)) / np.array(self.units)

    def by_name(self, theta: Array) -> dict[str, Array]:
        """Return the parameters of the scene by name."""
        values: dict[str, Array] = {}
        for change, (name, direction) in zip(theta, self.along, strict=False):
            base = values.get(name, params.values(self.scene, name).astype(float))
            values[name] = base + change * direction
        return values

    def _directions(self, scene: Scene) -> Inputs:
        """Return the changes of all inputs for each unknown of the scene."""
        changes = [params.push(scene, name, direction[None]) for name, direction in self.along]
        return Inputs(*(np.concatenate(inputs) for inputs in zip(*changes, strict=True)))

    def _tables(self, scene: Scene, derivatives: bool) -> tuple[Array, list[Array]]:
        """Return the times of a run, (L,), and for each trace its values and derivatives there.

        Each array, (L, D+1, G), contains the values and the derivatives with respect to D unknowns
        of the scene; D is 0 if no derivatives are requested.
        """
        method = method_for(self.scene, [name for name, _ in self.along], "rkn4")
        if params.by_differences(self.scene):
            return self._tables_by_differences(scene, method, derivatives)
        run = differentiable(scene, method, scene.duration, self.looks, self.grains)
        if not np.isfinite(run.velocity).all():
            raise RunFailed(f"the motion breaks down with steps of {run.step:.3g} s")
        # Nuisance parameters of the traces do not need the tangent of the motion.
        change = self._directions(scene) if derivatives and self.along else None
        motion = None if change is None else run.push(change)
        models = [model(scene, run, trace, change, motion) for trace in self.traces]
        return run.time, [
            np.concatenate((values[None], rates)).transpose(1, 0, 2) for values, rates in models
        ]

    def _tables_by_differences(
        self, scene: Scene, method: AnyMethod, derivatives: bool
    ) -> tuple[Array, list[Array]]:
        """Return what `_tables` does, from runs with changed parameters."""

        def values_of(near: Scene) -> Array:
            run = FixedRun.of(near, method, near.duration, self.looks, self.grains)
            return np.concatenate(
                [model(near, run, trace, None, None)[0] for trace in self.traces], axis=1
            )

        time = np.linspace(0.0, scene.duration, self.looks + 1)
        rows = values_of(scene)[None]
        if derivatives:
            size = float(np.abs(rows).max())
            floor = native_floor(self.looks * method.evaluations, scene.total_phase)
            slopes = [
                differentiate(scene, name, direction[None], values_of, floor * size, ACCURACY).slope
                for name, direction in self.along
            ]
            rows = np.concatenate((rows, *slopes))
        ends = np.cumsum([len(trace.places) for trace in self.traces])[:-1]
        return time, np.split(rows.transpose(1, 0, 2), ends, axis=2)

    def _predict(self, theta: Array, derivatives: bool) -> list[tuple[Array, Array]]:
        """Return the values of all traces in the scene, (T, G), and derivatives, (K, T, G)."""
        from scipy.interpolate import make_interp_spline

        scene = changed(self.scene, self.by_name(theta))
        time, tables = self._tables(scene, derivatives)
        predictions = []
        index = len(self.along)
        for trace, both in zip(self.traces, tables, strict=True):
            # A quintic spline through all times of the run gives values at the measured times.
            spline = make_interp_spline(time, both, k=5)
            late = theta[index] * self.units[index] if trace.trigger else 0.0
            when = trace.time - late
            inside = np.clip(when, 0.0, scene.duration)
            table = spline(inside)
            # Before the strike the grains rest, at their initial displacements if these are given.
            if trace.field == "velocity" or not scene.initial()[0].any():
                table[when < 0] = 0.0
            value = table[:, 0]
            jacobian = np.zeros((len(self.names), *value.shape))
            if derivatives:
                jacobian[: len(self.along)] = table[:, 1:].transpose(1, 0, 2)
            if trace.trigger:
                rate = spline(inside, 1)[:, 0] * ((when > 0)[:, None])
                jacobian[index] = -rate * self.units[index]
                index += 1
            # The nuisance parameters follow in the order in which they were added.
            if trace.gain:
                gain = 1.0 + theta[index]
                jacobian *= gain
                jacobian[index] = value
                value = gain * value
                index += 1
            if trace.offset:
                for column in range(value.shape[1]):
                    value[:, column] += theta[index] * self.units[index]
                    jacobian[index, :, column] = self.units[index]
                    index += 1
            predictions.append((value, jacobian))
        return predictions

    @property
    def lowest(self) -> Array:
        """Lower bounds of the relative changes, (K,)."""
        lowest = np.full(len(self.names), -np.inf)
        for index, (name, _) in enumerate(self.along):
            # A parameter of a formula that begins at 0 may change sign.
            free_sign = name in SIGNED or (name.startswith("chain.") and self.origin[index] == 0)
            if not free_sign:
                lowest[index] = NOTHING if name in MAY_VANISH else LOWEST
        return lowest

    def predict(self, theta: Array) -> list[Array]:
        """Return the values of all traces in the scene, (T, G)."""
        return [value for value, _ in self._predict(theta, False)]

    def residuals(self, theta: Array, derivatives: bool = False) -> tuple[Array, Array]:
        """Return all residuals over the noise, (R,), and their derivatives, (R, K)."""
        differences = []
        rates = []
        predictions = self._predict(theta, derivatives)
        for trace, (value, jacobian) in zip(self.traces, predictions, strict=True):
            noise = 1.0 if trace.noise is None else trace.noise
            differences.append(((value - trace.values) / noise).ravel())
            rates.append((jacobian / noise).reshape(len(self.names), -1))
        return np.concatenate(differences), np.concatenate(rates, axis=1).T

    def chi_square(self, theta: Array) -> float:
        """Return the sum of squared residuals over the noise."""
        return float((self.residuals(theta)[0] ** 2).sum()) / self.variance

    def minimise(self, start: Array, free: Any = slice(None)) -> Array:
        """Return the least-squares relative changes by Gauss-Newton steps in a trust region.

        Parameters
        ----------
        start : (K,) array
            Relative changes at the start.
        free : index
            Index of the unknowns that may change; by default all.
        """
        from scipy.optimize import least_squares

        def complete(rest: Array) -> Array:
            theta = start.copy()
            theta[free] = rest
            return theta

        # SciPy's limit on the gradient is absolute, so the residuals are scaled first.
        size = 1.0
        if all(trace.noise is None for trace in self.traces):
            size = max(float(np.abs(trace.values).max()) for trace in self.traces) or 1.0
        fitted = least_squares(
            lambda rest: self.residuals(complete(rest))[0] / size,
            start[free],
            lambda rest: self.residuals(complete(rest), True)[1][:, free] / size,
            x_scale="jac",
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
            max_nfev=100,
            bounds=(self.lowest[free], np.inf),
        )
        return complete(fitted.x)
