"""How far answers are from the truth, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..fields import Array
from ..reference import Reference
from ..tables import finite
from ..trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def errors(trajectory: Trajectory, reference: Reference) -> tuple[float, float]:
    """Return the relative errors of displacement and velocity.

    Each is max|x - x_true| / max|x_true|, the numerator over all samples and recorded grains, the denominator over
    all samples and all grains of the chain. It is NaN where the answer is.

    Raises
    ------
    InputError
        If the two were not recorded at the same times or are of different chains.
    """
    displacement, velocity = _relative(trajectory, reference)
    return float(displacement.max()), float(velocity.max())


def error(trajectory: Trajectory, reference: Reference) -> float:
    """Return the error as this package defines it: the larger of those of displacement and velocity."""
    return float(np.max(errors(trajectory, reference)))  # unlike max(), this keeps a NaN


def error_over_time(trajectory: Trajectory, reference: Reference) -> Array:
    """Return the error sample by sample, (T,); its largest value is `error`."""
    return np.maximum(*_relative(trajectory, reference))


def _relative(trajectory: Trajectory, reference: Reference) -> tuple[Array, Array]:
    grains, time = reference.displacement.shape[1], reference.time
    if trajectory.time.shape != time.shape or not np.allclose(trajectory.time, time, rtol=1e-12, atol=0):
        raise InputError([("time", "the answer and the reference were recorded at different times")])
    if trajectory.scene.chain.grains != grains:
        raise InputError([("grains", f"the answer has {trajectory.scene.chain.grains} grains, the reference {grains}")])
    columns = trajectory.grains - 1
    pairs = (trajectory.displacement, reference.displacement), (trajectory.velocity, reference.velocity)
    u, v = (np.abs(x - true[:, columns]).max(1) / (np.abs(true).max() or 1.0) for x, true in pairs)
    return u, v


@dataclass(frozen=True)
class Row:
    """One answer: its error against the reference, the error it expected, and its cost.

    Attributes
    ----------
    engine, integrator : str
    equation : int
    error, error_displacement, error_velocity : float
        As `error` and `errors` give them.
    expected_error : float
        What the answer itself says, `Trajectory.error_estimate.total`.
    integration_s : float
        s.
    steps, force_evaluations : int
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


@dataclass(frozen=True, eq=False)
class Comparison:
    """Answers to one scene beside the truth.

    Attributes
    ----------
    reference : Reference
    trajectories : tuple of Trajectory
    rows : tuple of Row
        One a trajectory, in the same order.
    """

    reference: Reference
    trajectories: tuple[Trajectory, ...]
    rows: tuple[Row, ...]

    def errors_over_time(self) -> list[Array]:
        """Return the error of every answer sample by sample, (T,) each."""
        return [error_over_time(answer, self.reference) for answer in self.trajectories]

    def to_json(self) -> dict[str, Any]:
        """Return what goes into a JSON file; numbers that are not finite become None."""
        reference = finite({"method": self.reference.method, "error": self.reference.error})
        rows = []
        for row in self.rows:
            fields = finite(asdict(row))
            del fields["integrator"]
            rows.append(fields)
        return {"reference": reference, "rows": rows}

    def table(self) -> str:
        """Return the comparison as text."""
        head = ["engine", "equation", "integrator", "error", "expected", "integration", "steps", "force evaluations"]
        body = [
            [row.engine, f"({row.equation})", row.integrator, f"{row.error:.2e}", f"{row.expected_error:.2e}",
             f"{row.integration_s:.3g} s", str(row.steps), str(row.force_evaluations)]
            for row in self.rows
        ]  # fmt: skip
        widths = [max(map(len, column)) for column in zip(head, *body, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in [head, *body]
        ]
        truth = f"reference: {self.reference.method}; itself known to {self.reference.error:.1e}"
        meaning = (
            "error: max|x - x_true| / max|x_true| over samples and grains, the larger of displacement and velocity"
        )
        return "\n".join([*lines, truth, meaning])

    def plot(self, axes: Sequence[Axes] | None = None) -> Figure:
        """Draw the answers, their errors over time and what they cost.

        Parameters
        ----------
        axes : three axes, optional
            Where to draw; by default in a figure of its own, which is returned.
        """
        from ..plotting import draw_comparison

        return draw_comparison(self, axes)


def compare(trajectories: Sequence[Trajectory], reference: Reference) -> Comparison:
    """Set answers to one scene beside the truth."""
    rows = []
    for answer in trajectories:
        displacement, velocity = errors(answer, reference)
        rows.append(
            Row(
                engine=answer.engine,
                equation=answer.equation,
                integrator=answer.cost.integrator,
                error=error(answer, reference),
                error_displacement=displacement,
                error_velocity=velocity,
                expected_error=answer.error_estimate.total,
                integration_s=answer.cost.integration_s,
                steps=answer.cost.steps,
                force_evaluations=answer.cost.force_evaluations,
            )
        )
    return Comparison(reference, tuple(trajectories), tuple(rows))
