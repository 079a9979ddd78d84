"""Comparison of engines with a reference solution: true errors, estimated errors and cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np

from ..engines import class_of
from ..errors import InputError, shown
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import (
    LEAST_ERROR,
    LEAST_LETTER,
    PRINTED_WIDTH,
    Axes,
    label_ends,
    legend,
    letter_panels,
    panels,
    set_title,
    window,
)
from ..util.tables import align, finite, number, wrap
from ..util.tabular import NamedColumn, Tabular, of_rows
from .reference import Reference

__dir__ = listed(__name__)


def errors(trajectory: Trajectory, reference: Reference) -> tuple[float, float]:
    """Return the relative errors of displacement and velocity, each relative to its largest value.

    Each error is ``max|x - x_true|`` over all samples and recorded grains, divided by the largest
    ``|x_true|`` of any grain of the chain at any time of the run. It is NaN if the trajectory
    contains NaN.

    Parameters
    ----------
    trajectory : Trajectory
    reference : Reference

    Returns
    -------
    (float, float)
        Errors of the displacement and of the velocity.

    Raises
    ------
    InputError
        If both were recorded at different times, or if their numbers of grains differ.
    """
    displacement, velocity = _relative(trajectory, reference)
    return float(displacement.max()), float(velocity.max())


def error(trajectory: Trajectory, reference: Reference) -> float:
    """Return the relative error of a trajectory: the larger of the errors that `errors` returns.

    Parameters
    ----------
    trajectory : Trajectory
    reference : Reference

    Returns
    -------
    float
        Error relative to the largest value.
    """
    # Unlike the maximum of Python, this one returns NaN if any value is NaN.
    return float(np.max(errors(trajectory, reference)))


def error_over_time(trajectory: Trajectory, reference: Reference) -> Array:
    """Return the error sample by sample, (T,); its largest value is `error`.

    Parameters
    ----------
    trajectory : Trajectory
    reference : Reference

    Returns
    -------
    (T,) array
        Relative error at each sample.
    """
    return np.maximum(*_relative(trajectory, reference))


def _relative(trajectory: Trajectory, reference: Reference) -> tuple[Array, Array]:
    grains = reference.displacement.shape[1]
    time = reference.time
    alike = trajectory.time.shape == time.shape
    if not alike or not np.allclose(trajectory.time, time, rtol=1e-12, atol=0):
        message = "the trajectory and the reference were recorded at different times"
        raise InputError.at("time", message)
    if trajectory.scene.chain.grains != grains:
        message = f"the run has {trajectory.scene.chain.grains}, but the reference {grains}"
        raise InputError.at("grains", message)
    columns = trajectory.grains - 1

    def relative(x: Array, true: Array, scale: float) -> Array:
        return np.asarray(np.abs(x - true[:, columns]).max(1) / scale)

    return (
        relative(trajectory.displacement, reference.displacement, reference.scale[0]),
        relative(trajectory.velocity, reference.velocity, reference.scale[1]),
    )


@dataclass(frozen=True)
class ComparisonRow:
    """True error, estimated error and cost of one engine.

    Attributes
    ----------
    engine, integrator : str
        Name of the engine; name of the integrator.
    equation : int
        Number of the equation of the paper that the engine solves.
    error, error_displacement, error_velocity : float
        Larger of the two other errors; relative error of the displacement; relative error of the
        velocity.
    expected_error : float
        The engine's own estimate, `Trajectory.error_estimate.total`.
    integration_s, compile_s : float
        Time of the integration without compilation, s; time of compilation at the first call, s.
    steps, force_evaluations : int
        Number of steps; number of force evaluations, each for all grains.
    """

    engine: str
    equation: int
    integrator: str
    error: float
    error_displacement: float
    error_velocity: float
    expected_error: float
    integration_s: float
    steps: int
    force_evaluations: int
    compile_s: float


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Shown, Tabular):
    """Trajectories of one scene compared with its reference solution.

    Attributes
    ----------
    reference : Reference
    trajectories : tuple of Trajectory
    rows : tuple of ComparisonRow
        One row for each trajectory, in the same order.
    lossless : ComparisonRow, optional
        Row of the chain without damping. Its error is the change if damping is left out, and its
        expected error is `Scene.damping_effect`.
    """

    reference: Reference
    trajectories: tuple[Trajectory, ...]
    rows: tuple[ComparisonRow, ...]
    lossless: ComparisonRow | None = None

    def errors_over_time(self) -> list[Array]:
        """Return the error of every trajectory sample by sample, (T,) each."""
        return [error_over_time(answer, self.reference) for answer in self.trajectories]

    def to_json(self) -> dict[str, Any]:
        """Return the rows for a JSON file; numbers that are not finite become None."""
        reference = finite({"method": self.reference.method, "error": self.reference.error})
        numbers = {"reference": reference, "rows": [_numbers(row) for row in self.rows]}
        if self.lossless:
            numbers["without_damping"] = _numbers(self.lossless)
        return numbers

    def _summary(self) -> Iterator[Sequence[str]]:
        yield (
            "engine",
            "Eq.",
            "integrator",
            "error",
            "expected",
            "integration",
            "steps",
            "evaluations",
        )
        for row in (*self.rows, *([self.lossless] if self.lossless else [])):
            errors = f"{row.error:.2e}", f"{row.expected_error:.2e}"
            counts = number(row.integration_s, unit="s"), str(row.steps), str(row.force_evaluations)
            yield row.engine, f"({row.equation})", row.integrator, *errors, *counts

    def table(self) -> str:
        """Return the comparison as text."""
        error = f"{self.reference.error:.1e}"
        source = f"reference: {self.reference.method}; its own error is about {error}"
        meaning = (
            "error: max|x - x_true| over samples and grains, divided by max|x_true| at any time, "
            "the larger of displacement and velocity; evaluations: of the forces of all contacts"
        )
        sentences = [source, meaning]
        if self.lossless:
            sentences.append(
                "without damping: the change if damping is left out, and its bound by the plan"
            )
        return "\n".join([*align(self._summary()), *wrap(*sentences)])

    def plot(self, ax: Axes | Sequence[Axes] | None = None) -> Axes:
        """Draw the trajectories, their errors over time and their cost, and return the first axes.

        Parameters
        ----------
        ax : axes, or up to four of them, optional
            On a single axes only the trajectories are drawn. By default a new figure shows the
            trajectories, errors, costs, and the motion over time and depth.
        """
        own = {}
        if ax is None:
            picture = window(PRINTED_WIDTH, 6.4)
            own = picture.subplot_mosaic([["map", "error"], ["wave", "cost"]])
            ax = [own[name] for name in ("wave", "error", "cost", "map")]
        wave, *others = panels(ax)
        _draw_wave(self, wave)
        legend(wave)
        for draw, axes in zip((_draw_errors, _draw_cost, _draw_map), others, strict=False):
            draw(self, axes)
        letter_panels(list(own.values()))
        return wave

    def _columns(self) -> Iterator[NamedColumn]:
        return of_rows([_numbers(row) for row in self.rows])


def _numbers(row: ComparisonRow) -> dict[str, Any]:
    """Return a row for a JSON file."""
    fields = finite(asdict(row))
    del fields["integrator"]
    return fields


def compare(
    trajectories: Sequence[Trajectory],
    reference: Reference,
    lossless: Trajectory | None = None,
) -> Comparison:
    """Compare trajectories of one scene with its reference solution.

    Parameters
    ----------
    trajectories : list of Trajectory
        Trajectories of the same scene.
    reference : Reference
    lossless : Trajectory, optional
        Trajectory of the same scene without damping.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If an argument is of another type, or as for `errors`.
    """
    several = isinstance(trajectories, list | tuple) and len(trajectories) > 0
    if not several or not all(isinstance(answer, Trajectory) for answer in trajectories):
        message = f"must be a list of one trajectory or more (got {shown(trajectories)})"
        raise InputError.at("trajectories", message)
    if not isinstance(reference, Reference):
        raise InputError.at("reference", f"must be a reference solution (got {shown(reference)})")
    rows = tuple(_row(answer, reference) for answer in trajectories)
    if lossless is None:
        return Comparison(reference, tuple(trajectories), rows)
    effect = trajectories[0].scene.damping_effect
    row = replace(_row(lossless, reference), engine="without damping", expected_error=effect)
    return Comparison(reference, tuple(trajectories), rows, row)


def _row(answer: Trajectory, reference: Reference) -> ComparisonRow:
    displacement, velocity = errors(answer, reference)
    return ComparisonRow(
        engine=answer.engine,
        equation=answer.equation,
        integrator=answer.cost.integrator,
        error=float(np.maximum(displacement, velocity)),
        error_displacement=displacement,
        error_velocity=velocity,
        expected_error=answer.error_estimate.total,
        integration_s=answer.cost.integration_s,
        steps=answer.cost.steps,
        force_evaluations=answer.cost.force_evaluations,
        compile_s=answer.cost.compile_s,
    )


WIDEST = 60  # Largest number of grains shown.
# Offsets of names from their markers in points; neighbours alternate above and below.
NAME_PLACES = ((13, True), (-13, False), (30, True), (-30, False))


def _draw_wave(comparison: Comparison, axes: Axes) -> None:
    """Draw velocity against grain number at the end, reference as a line, engines as markers."""
    reference = comparison.reference
    scene = comparison.trajectories[0].scene
    unit = scene.strike_velocity
    label = r"velocity / strike velocity $v_0$"
    if not unit:
        unit = 1.0
        label = "velocity downward (m/s)"
    last = reference.velocity[-1] / unit
    axes.plot(np.arange(1, last.size + 1), last, color="0.55", lw=2, label="reference")
    first, end = _window(reference.velocity[-1])
    shown = _shown(comparison)
    count = len(shown)
    for index, answer in enumerate(shown):
        visible = (answer.grains >= first) & (answer.grains <= end)
        axes.plot(
            answer.grains[visible],
            answer.velocity[-1, visible] / unit,
            linestyle="none",
            marker=class_of(answer.engine).style[1],
            # Markers become smaller so that no marker hides another.
            markersize=7.5 - 3.5 * index / max(1, count - 1),
            markerfacecolor="none",
            markeredgewidth=1.3,
            color=class_of(answer.engine).style[0],
            label=answer.engine,
        )
    axes.axhline(0, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="grain number, from the top", ylabel=label, xlim=(first - 0.5, end + 0.5))
    set_title(axes, f"Motion at t = {scene.duration * 1e6:g} µs")
    # The reference sets the scale; answers with large errors may leave the axes.
    span = np.array([last.min(), last.max()])
    if np.ptp(span):
        axes.set_ylim(span + 0.25 * np.ptp(span) * np.array([-1, 1]))
    limits = axes.get_ylim()
    far = [answer.engine for answer in shown if _leaves(answer.velocity[-1] / unit, limits)]
    if far:
        text = f"partly beyond the scale: {', '.join(far)}"
        axes.text(0.01, 0.02, text, transform=axes.transAxes, fontsize=LEAST_LETTER)


def _shown(comparison: Comparison) -> list[Trajectory]:
    """Return all trajectories of Eq. (1), and the most accurate one of the other equations."""
    pairs = list(zip(comparison.rows, comparison.trajectories, strict=True))
    approximate = [(row.error, index) for index, (row, _) in enumerate(pairs) if row.equation != 1]
    best = min(approximate)[1] if approximate else None
    return [t for index, (row, t) in enumerate(pairs) if row.equation == 1 or index == best]


def _draw_map(comparison: Comparison, axes: Axes) -> None:
    """Draw the motion of the trajectory with the smallest error over time and depth."""
    errors = [row.error for row in comparison.rows]
    comparison.trajectories[int(np.argmin(errors))].plot(axes)
    last = _window(comparison.reference.velocity[-1])[1]
    axes.set_ylim(last + 0.5, 0.5)


def _window(velocity: Array) -> tuple[int, int]:
    """Return the first and last grain that move, at most `WIDEST` grains around the fastest."""
    speed = np.abs(velocity)
    moving = np.flatnonzero(speed > 1e-3 * speed.max())
    if moving.size == 0:
        return 1, min(WIDEST, velocity.size)
    # Four grains at rest are shown on either side.
    first = max(0, moving[0] - 4)
    last = min(velocity.size - 1, moving[-1] + 4)
    if last - first >= WIDEST:
        first = int(np.clip(speed.argmax() - WIDEST // 2, first, last - WIDEST + 1))
        last = first + WIDEST - 1
    return int(first) + 1, int(last) + 1


def _draw_errors(comparison: Comparison, axes: Axes) -> None:
    """Draw the error over time, with the expected error as a dashed line."""
    reference = comparison.reference
    time = reference.time * 1e6
    curves = comparison.errors_over_time()
    for answer, row, curve in zip(comparison.trajectories, comparison.rows, curves, strict=True):
        values = np.maximum(curve, LEAST_ERROR)
        colour = class_of(answer.engine).style[0]
        # The first sample is left out because its error is 0.
        axes.semilogy(time[1:], values[1:], color=colour, lw=1.3, label=answer.engine)
        axes.axhline(max(row.expected_error, LEAST_ERROR), color=colour, ls="--", lw=1.3)
    axes.axhline(max(reference.error, LEAST_ERROR), color="0.55", ls=":", lw=1.5)
    axes.set(xlabel="time (µs)", ylabel="relative error")
    set_title(axes, "Error (dashed: expected)")
    axes.margins(y=0.12)
    ends = [
        (float(max(curve[-1], LEAST_ERROR)), row.engine, class_of(row.engine).style[0])
        for row, curve in zip(comparison.rows, curves, strict=True)
    ]
    label_ends(axes, [*ends, (float(max(reference.error, LEAST_ERROR)), "reference", "0.4")])


def _draw_cost(comparison: Comparison, axes: Axes) -> None:
    """Draw the error against the time of the integration."""
    cheapest_first = sorted(comparison.rows, key=lambda row: row.integration_s)
    for row, (height, above) in zip(cheapest_first, cycle(NAME_PLACES), strict=False):
        x = max(row.integration_s, 1e-9)
        y = max(row.error, LEAST_ERROR)
        expected = max(row.expected_error, LEAST_ERROR)
        colour, marker = class_of(row.engine).style
        axes.loglog([x, x], [y, expected], color=colour, ls="--", lw=1.3)
        axes.loglog(x, expected, "_", ms=10, mew=1.8, color=colour)
        name = row.engine if row.integrator == row.engine else f"{row.engine}, {row.integrator}"
        axes.loglog(x, y, marker, ms=8, color=colour, label=name)
        end = max(y, expected) if above else min(y, expected)
        text: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": "small"}
        axes.annotate(name, (x, end), (0, height), textcoords="offset points", color=colour, **text)
    axes.set(xlabel="integration time (s)", ylabel="relative error")
    set_title(axes, "Error and cost (bar: expected)")
    axes.margins(x=0.4, y=0.3)


def _leaves(values: Array, limits: tuple[float, float]) -> bool:
    return bool(np.any((values < limits[0]) | (values > limits[1])))
