"""What a fit does not know, as relative changes, and what they leave of the differences from traces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InputError, RunFailed, shown
from ..integrators.adjoint import DifferentiableRun, Inputs
from ..integrators.splittings import SPLITTINGS
from ..scene.scene import Scene
from ..util.arrays import Array
from . import parameters as params
from .changes import changed
from .traces import Traces, model

TURN = 0.5  # of the fastest motion in a step of rkn4 at first, through all of which quintic splines go, rad
SIGNED = ("displacement", "velocity", "drive", "force", "amplitude")  # what may change its sign
LEAST = 0.9  # by how much anything else may become less, of itself


class Problem:
    """What is not known, as K relative changes, and the residuals that they leave."""

    def __init__(self, scene: Scene, traces: Sequence[Traces], parameters: Mapping[str, Any]):
        self.scene, self.traces, self.variance = scene, traces, 1.0
        self.names: list[str] = []
        self.units: list[float] = []  # of the estimates, in relative changes
        self.origin: list[float] = []
        self.along: list[tuple[str, Array]] = []
        for name in params.check(scene, parameters):
            self._add(name, params.values(scene, name), parameters[name])
        for number, one in enumerate(traces):
            suffix = f" {number + 1}" if len(traces) > 1 else ""
            span, size = one.time[-1] - one.time[0], float(np.abs(one.values).max()) or 1.0
            nuisance = [("trigger" + suffix, 0.0, span)] * one.trigger + [
                ("gain" + suffix, 1.0, 1.0)
            ] * one.gain
            places = [f"offset{suffix} {place}" for place in one.places] if one.offset else []
            for label, begin, unit in nuisance + [(label, 0.0, size) for label in places]:
                self.names.append(label)
                self.origin.append(begin)
                self.units.append(unit)
        self.looks = max(8, int(np.ceil(scene.duration * scene.highest_frequency / TURN)))
        self.grains = np.unique(np.concatenate([one.grains(scene) for one in traces]))

    def _add(self, name: str, base: Array, how: Any) -> None:
        if isinstance(how, str) and how == "common":
            if not base.any():
                raise InputError([(name, "is 0 everywhere, which no factor changes: name entries")])
            given = base[base != 0]
            one = bool((given == given[0]).all())
            self.names.append(name)
            self.origin.append(float(given[0]) if one else 1.0)
            self.units.append(float(given[0]) if one else 1.0)
            self.along.append((name, base))
            return
        entries = range(1, base.size + 1) if isinstance(how, str) and how == "each" else how
        if isinstance(entries, str) or not all(1 <= entry <= base.size for entry in entries):
            raise InputError(
                [
                    (
                        name,
                        f'must be "common", "each" or numbers from 1 to {base.size} (got {shown(how)})',
                    )
                ]
            )
        for entry in entries:
            unit = float(base[entry - 1]) or float(np.abs(base).max()) or 1.0
            self.names.append(f"{name} {entry}")
            self.origin.append(float(base[entry - 1]))
            self.units.append(unit)
            self.along.append((name, unit * (np.arange(base.size) == entry - 1)))

    def estimates(self, theta: Array) -> Array:
        """Return the numbers in their units."""
        return np.array(self.origin) + np.array(self.units) * theta

    def free(self, estimate: Array) -> Array:
        """Return the relative changes for numbers in their units."""
        return (estimate - np.array(self.origin)) / np.array(self.units)

    def by_name(self, theta: Array) -> dict[str, Array]:
        """Return the parameters of the scene."""
        made: dict[str, Array] = {}
        for change, (name, direction) in zip(theta, self.along, strict=False):
            made[name] = (
                made.get(name, params.values(self.scene, name).astype(float)) + change * direction
            )
        return made

    def _directions(self, scene: Scene) -> Inputs:
        """Return how all inputs change with each relative change of the scene."""
        parts = [params.push(scene, name, direction[None]) for name, direction in self.along]
        return Inputs(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def _said(self, theta: Array, derivatives: bool) -> list[tuple[Array, Array]]:
        """Return what the scene says of all traces, (T, G), and the derivatives, (K, T, G)."""
        from scipy.interpolate import make_interp_spline

        scene = changed(self.scene, self.by_name(theta))
        run = DifferentiableRun(scene, SPLITTINGS["rkn4"], scene.duration, self.looks, self.grains)
        if not np.isfinite(run.velocity).all():
            raise RunFailed(f"the motion breaks down with steps of {run.step:.3g} s")
        change = self._directions(scene) if derivatives and self.along else None
        moved = None if change is None else run.push(change)
        said, at = [], len(self.along)
        for one in self.traces:
            values, rates = model(scene, run, one, change, moved)
            together = np.concatenate((values[None], rates)).transpose(1, 0, 2)
            spline = make_interp_spline(run.time, together, k=5)
            late = theta[at] * self.units[at] if one.trigger else 0.0
            when = one.time - late
            inside = np.clip(when, 0.0, scene.duration)
            found = spline(inside)
            found[when < 0, 1:] = 0.0
            value, jacobian = found[:, 0], np.zeros((len(self.names), *found[:, 0].shape))
            if derivatives:
                jacobian[: len(self.along)] = found[:, 1:].transpose(1, 0, 2)
            rate = spline(inside, 1)[:, 0] * ((when > 0)[:, None])
            gain = 1.0
            if one.trigger:
                jacobian[at] = -rate * self.units[at]
                at += 1
            if one.gain:
                gain = 1.0 + theta[at]
                jacobian *= gain
                jacobian[at] = value
                at += 1
            value = gain * value
            if one.offset:
                for column in range(value.shape[1]):
                    value[:, column] += theta[at] * self.units[at]
                    jacobian[at, :, column] = self.units[at]
                    at += 1
            said.append((value, jacobian))
        return said

    def predicted(self, theta: Array) -> list[Array]:
        """Return what is expected in every trace, (T, G)."""
        return [value for value, _ in self._said(theta, False)]

    def residuals(self, theta: Array, derivatives: bool = False) -> tuple[Array, Array]:
        """Return all differences over the noise, (R,), and their derivatives, (R, K)."""
        left, rates = [], []
        for one, (value, jacobian) in zip(self.traces, self._said(theta, derivatives), strict=True):
            noise = 1.0 if one.noise is None else one.noise
            left.append(((value - one.values) / noise).ravel())
            rates.append((jacobian / noise).reshape(len(self.names), -1))
        return np.concatenate(left), np.concatenate(rates, axis=1).T

    def least(self, start: Array, whole: Any, free: Any) -> Array:
        """Return what leaves the least squares, by Gauss and Newton's steps within a trust region."""
        from scipy.optimize import least_squares

        positive = [name not in SIGNED for name, _ in self.along]
        lowest = np.full(len(self.names), -np.inf)
        lowest[: len(positive)][positive] = -LEAST
        # without a noise, residuals are in m or m/s, in which SciPy's absolute limit on the gradient means nothing
        size = 1.0
        if all(trace.noise is None for trace in self.traces):
            size = max(float(np.abs(trace.values).max()) for trace in self.traces) or 1.0
        return least_squares(
            lambda rest: self.residuals(whole(rest))[0] / size, start,
            lambda rest: self.residuals(whole(rest), True)[1][:, free] / size,
            x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100, bounds=(lowest[free], np.inf),
        ).x  # fmt: skip
