"""Reading of displacements and velocities from LAMMPS dumps of `lmpchain deck` or other decks."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import NamedTuple

import numpy as np

from ..errors import InputError, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import expanded
from .dump_checks import (
    CHECKS,
    DumpedMotion,
    FirstFrame,
    check_course,
    check_frames,
    check_grains,
    check_jumps,
    drawn_diameter,
    find_misfit,
)
from .dump_frames import AXES, COLUMNS, Frames, read_frames
from .record import Cost, ErrorEstimate, Record


class _Column(NamedTuple):
    """Positions and velocities along the axis of the column, (T, N) each, by atom number.

    Attributes
    ----------
    z : (T, N) array
        Positions, m.
    vz : (T, N) array
        Velocities, m/s.
    v_phi : (T, N) array or None
        Displacements, m; None if the dump does not contain them.
    slack : float
        Rounding error of the distance between two grains, m.
    """

    z: Array
    vz: Array
    v_phi: Array | None
    slack: float


def read_dump(
    path: str | PathLike[str],
    scene: Scene,
    equilibrium: Sequence[float] | Array | None = None,
    axis: str | None = None,
    units: str | Sequence[float] | None = None,
) -> Record:
    """Read a LAMMPS dump as the trajectory of a scene; see `lmpchain.Trajectory.from_dump`.

    Raises
    ------
    InputError
        If the dump cannot be read, or does not belong to the scene.
    """
    path = expanded(path)
    name = str(path)
    if axis not in (None, *AXES):
        raise InputError.at(
            "axis", f"must be x, y or z, the axis of the column (got {shown(axis)})"
        )
    rest = None if equilibrium is None else _check_rest(equilibrium, scene.chain.grains)
    frames = read_frames(path, scene.chain.grains, most=2 * scene.samples, units=units)
    check_frames(name, scene, frames)
    axis = axis or _find_axis(name, frames)
    check_jumps(name, frames, axis)
    columns = frames.in_si()
    if f"v{axis}" not in columns:
        raise InputError.at(
            name, f"has no column v{axis}, but its grains are in line along {axis}: {COLUMNS}"
        )
    # The numbers of the file are used, because sums with box lengths have different digits.
    written = frames.columns[frames.position_columns[AXES.index(axis)]]
    length, *_, velocity = frames.units
    z = frames.positions(axis)
    v_phi = columns.get("v_phi")
    spacing = float(np.spacing(np.abs(z[0]).max()))
    rounding = 2 * length * last_digit(written[0]) + 4 * spacing
    column = _Column(z, columns[f"v{axis}"], v_phi, rounding)
    # A deck of lmpchain writes v_phi, and its z points up.
    directions = [-1.0] if v_phi is not None and axis == "z" else _directions(scene, z[0], rest)
    motion, first = _orient(name, scene, directions, column, rest)
    check_grains(name, scene, columns, motion.order, drawn_diameter(scene, motion, first))
    mover = motion.order[int(np.abs(motion.velocity).sum(0).argmax())]
    if v_phi is None:
        _check_digits(name, written[:, mover], length, float(np.ptp(z[:, mover])))
        origin = f"heights minus {'first' if rest is None else 'given'} heights"
    else:
        origin = "v_phi"
    speeds = frames.columns[f"v{axis}"][:, mover]
    numbers = (written if v_phi is None else frames.columns["v_phi"])[:, mover]
    total = int(frames.steps[-1] - frames.steps[0])
    # Grains far from z = 0 have a coarser last digit than the grain with the largest motion.
    digit = length * last_digit(numbers)
    if v_phi is None:
        digit = max(digit, rounding / 2)
    speed_digit = velocity * last_digit(speeds)
    check_course(name, scene, motion, total, digit, spacing)
    recorded = scene.recorded - 1
    return Record(
        scene=scene,
        engine="lammps",
        equation=1,
        time=scene.time.copy(),
        grains=scene.recorded.copy(),
        displacement=motion.displacement[:, recorded].copy(),
        velocity=motion.velocity[:, recorded].copy(),
        error_estimate=ErrorEstimate(0.0, float("inf")),
        cost=Cost(
            integration_s=0.0,
            estimate_s=0.0,
            setup_s=0.0,
            steps=total,
            force_evaluations=total,
            active_grains=scene.chain.grains,
            integrator="unknown",
            step_s=scene.duration / total,
            ranks=1,
        ),
        provenance={
            "dump": name,
            "displacement": origin,
            "column": f"along {axis}, {axis} points {'up' if motion.down < 0 else 'down'}",
            "precision": _describe_precision(length * last_digit(numbers), speed_digit, motion),
            "displacement_digit": repr(digit),
            "velocity_digit": repr(speed_digit),
        },
    )


def _orient(
    name: str, scene: Scene, directions: Sequence[float], column: _Column, rest: Array | None
) -> tuple[DumpedMotion, FirstFrame]:
    """Return the motion along the first direction that agrees with the initial state."""
    z, vz, v_phi, slack = column
    faults = []
    for down in directions:
        # Grains are numbered from the top, independent of the atom numbers.
        order = np.argsort(down * z[0], kind="stable")
        if v_phi is not None:
            displacement = v_phi[:, order]
        elif rest is not None:
            displacement = down * (z[:, order] - rest)
        else:
            displacement = down * (z[:, order] - z[0, order])
            # The first frame is not at rest if the scene begins with a displacement.
            displacement += scene.initial()[0]
        motion = DumpedMotion(down, order, displacement, down * vz[:, order])
        first = FirstFrame(down * z[0, order], slack, v_phi is not None)
        fault = find_misfit(scene, motion, first)
        if not fault:
            return motion, first
        faults.append(fault)
    raise InputError.at(name, faults[0])


def _find_axis(name: str, frames: Frames) -> str:
    """Return the axis along which the grains of the first frame are far apart."""
    spread = [float(np.ptp(frames.positions(axis)[0])) for axis in AXES]
    longest = int(np.argmax(spread))
    # An inclined column has no axis.
    if not spread[longest] > 2 * sorted(spread)[-2]:
        raise InputError.at(
            "axis",
            f"{name}: its grains are not in line along x, y or z: give the axis of the column",
        )
    return AXES[longest]


def _describe_precision(digit: float, speed_digit: float, motion: DumpedMotion) -> str:
    """Return the precision of a dump as text, given its last digits, m and m/s."""
    texts = []
    for quantity, unit, last, values in (
        ("displacement", "m", digit, motion.displacement),
        ("velocity", "m/s", speed_digit, motion.velocity),
    ):
        half = last / 2
        largest = float(np.abs(values).max())
        share = half / (largest or np.inf)
        texts.append(f"{quantity} within {half:.2g} {unit}, {share:.1g} of the largest")
    return "; ".join(texts)


def _check_rest(equilibrium: Sequence[float] | Array, grains: int) -> Array:
    """Return the heights at rest as (N,) numbers; raise `InputError` if they are invalid."""
    try:
        rest = np.asarray(equilibrium, dtype=float)
    except (TypeError, ValueError):
        rest = np.empty(0)
    if rest.shape != (grains,) or not np.isfinite(rest).all():
        raise InputError.at(
            "equilibrium", f"must be the heights at rest of the {grains} grains, m, from the top"
        )
    return rest


def _directions(scene: Scene, z: Array, rest: Array | None) -> list[float]:
    """Return the directions -1 (z points up) and 1 (down), the likelier one first.

    The overlaps decide, because they increase with the weight above. The differences between the
    measured distances of centres and those of the first sample of the scene vary least along the
    column in the right direction.
    """
    if rest is not None:
        return [1.0 if rest[-1] > rest[0] else -1.0]
    chain = scene.chain
    gaps = chain.contact_lengths[1:-1] - chain.equilibrium_overlap + np.diff(scene.initial()[0])
    return sorted((-1.0, 1.0), key=lambda down: float(np.ptp(np.diff(np.sort(down * z)) - gaps)))


def last_digit(values: Array) -> float:
    """Return the size of the last digit of the largest number.

    If all numbers are in single precision, the spacing of single precision is returned, even if
    more digits were written.
    """
    largest = float(np.abs(values).max())
    numbers = values.tolist()
    for digits in range(1, 17):
        if largest and all(float(f"{number:.{digits - 1}e}") == number for number in numbers):
            return float(10.0 ** (np.floor(np.log10(largest)) - digits + 1))
    single = values.astype(np.float32)
    return float(np.spacing(np.abs(single).max() if (single == values).all() else largest))


def _check_digits(name: str, heights: Array, unit: float, motion: float) -> None:
    """Raise `InputError` if the digits of heights, (T,), are too few to resolve a motion, m.

    `unit` is the unit of the heights, m.
    """
    digit = last_digit(heights)
    if heights.any() and motion < CHECKS.levels * unit * digit:
        digits = round(np.log10(np.abs(heights).max() / digit) + 0.5)
        cure = "write them with dump_modify format float %.17g, or dump v_phi"
        raise InputError.at(
            name,
            f"its heights have {digits} digits, too few for displacements of {motion:.1g} m: "
            f"{cure}, as lmpchain deck does",
        )
