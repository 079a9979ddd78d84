"""Check whether a LAMMPS dump belongs to a scene: frames, grains, first frame and motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..scene.excitation import Impulse
from ..scene.scene import Scene
from ..util.arrays import Array
from .dump_frames import Frames


class DumpChecks(NamedTuple):
    """Limits within which a dump matches a scene.

    Attributes
    ----------
    start : float
        Largest difference of the first frame from the initial state, over the largest value in the
        dump.
    overlap : float
        Largest difference of an overlap in the first frame, over the sum of the overlap at rest and
        twice the largest displacement.
    distance : float
        Relative difference of a distance between neighbours above which a message states the
        distances instead of the overlaps.
    grain : float
        Largest relative difference of a radius or a mass. The six digits that LAMMPS writes by
        default cause half of this difference.
    clock : float
        Largest difference of the time of a frame, over the duration.
    course : float
        Largest relative difference between the change of a displacement or velocity and the time
        integral of its rate, in addition to the errors of time steps and sampling.
    gauge : float
        Largest diameter of grains that are drawn smaller than they are, over the largest overlap.
        It is ten times the largest ratio in decks that lmpchain writes.
    levels : int
        Smallest number of units in the last digit of a height that the motion must span.
    """

    start: float = 1e-6
    overlap: float = 1e-5
    distance: float = 1e-4
    grain: float = 1e-5
    clock: float = 1e-6
    course: float = 0.002
    gauge: float = 30.0
    levels: int = 100


class SampledMotion(NamedTuple):
    """Sampling limits within which changes of the motion can be compared with its rates.

    Angles are omega h / 2: half the phase of the fastest motion omega from one frame to the next.

    Attributes
    ----------
    fewest : int
        Smallest number of samples for which the time integral of a motion that starts from rest is
        accurate enough.
    single : float
        Largest angle, rad, at which grains are compared one by one. At larger angles, groups of
        grains are compared.
    group : float
        Number of grains in a group, over the angle. The mean motion of such a group is slow enough.
    slowest : float
        Largest angle of the mean motion of a group, rad.
    leak : float
        Relative uncertainty of the comparison of groups, due to faster motion at their borders.
    forces : float
        Largest angle at which accelerations are compared with forces, rad.
    """

    fewest: int = 6
    single: float = 0.8
    group: float = 3.0
    slowest: float = 0.6
    leak: float = 0.4
    forces: float = 1.2


CHECKS = DumpChecks()
SAMPLED = SampledMotion()
CURE = "give the scene that the dump was made for"


class DumpedMotion(NamedTuple):
    """Motion of the grains in their order from the top.

    Attributes
    ----------
    down : float
        1 if the axis of the column points down, -1 if up.
    order : (N,) array
        Column of the dump for each grain.
    displacement : (T, N) array
        Displacements, m, positive downward.
    velocity : (T, N) array
        Velocities, m/s, positive downward.
    """

    down: float
    order: np.ndarray
    displacement: Array
    velocity: Array


class FirstFrame(NamedTuple):
    """Positions of the grains in the first frame.

    Attributes
    ----------
    depths : (N,) array
        Positions of the grains, m, which increase downward.
    slack : float
        Rounding error of the distance between two grains, m.
    drawn : bool
        Whether grains may be drawn smaller than they are, as in decks that lmpchain writes.
    """

    depths: Array
    slack: float
    drawn: bool


def check_frames(name: str, scene: Scene, frames: Frames) -> None:
    """Raise `InputError` unless number and times of the frames match the samples."""
    steps = frames.steps
    samples = scene.samples
    interval = scene.sampling_interval
    if len(steps) != samples:
        duration = interval * (len(steps) - 1)
        cure = "run LAMMPS to its end"
        if len(steps) > 1:
            cure = (
                f"set samples = {len(steps)}, duration = {duration:.6g} in the scene, if its "
                f"samples are as far apart as the frames; or {cure}"
            )
        raise InputError.at(
            name,
            f"has {len(steps)} whole frames, but the scene has {samples} samples over a duration "
            f"of {scene.duration:.6g} s: {cure}",
        )
    if not all(np.isfinite(values).all() for values in frames.columns.values()):
        raise InputError.at(
            name, "contains numbers that are not finite, from a breakdown: use a shorter step"
        )
    intervals = np.diff(steps)
    if (intervals != intervals[0]).any():
        raise InputError.at(
            name, "its frames are not equally far apart: dump every N steps, from the start"
        )
    if np.isnan(frames.times).all():
        return
    times = frames.times - frames.times[0]
    # A missing or infinite time also fails this comparison.
    if not (np.abs(times - scene.time) <= CHECKS.clock * scene.duration).all():
        raise InputError.at(
            name,
            f"its frames are {times[-1] / scene.intervals:.6g} s apart by ITEM: TIME or v_time, "
            f"but the samples of the scene are {interval:.6g} s apart: set the duration of the "
            f"scene to {times[-1]:.6g} s, or {CURE}",
        )


def check_jumps(name: str, frames: Frames, axis: str) -> None:
    """Raise `InputError` if a periodic box wraps positions along an axis."""
    number = "xyz".index(axis)
    jumps = np.abs(np.diff(frames.positions(axis), axis=0))
    if frames.periodic[number] and (jumps > frames.sides[1:, number, None] / 2).any():
        raise InputError.at(
            name,
            f"its positions {axis} jump across the periodic box: dump xu yu zu, or x y z with the "
            "image flags ix iy iz",
        )


def find_misfit(scene: Scene, motion: DumpedMotion, first: FirstFrame) -> str:
    """Return the difference of the first frame from the scene's initial state, or ""."""
    gauge = drawn_diameter(scene, motion, first)
    distance, overlap = ("", "") if gauge else _find_gap(scene, motion, first)
    # Wrong distances have many consequences; overlaps also differ by wrong initial displacements.
    return distance or _find_start(scene, motion, first) or overlap


def _find_start(scene: Scene, motion: DumpedMotion, first: FirstFrame) -> str:
    """Return the first grain with a wrong initial state as text, or ""."""
    u, v = scene.initial()
    rounding = 1e-15 * np.abs(first.depths).max()
    for quantity, unit, values, start, slack in (
        ("velocity", "m/s", motion.velocity, v, 0.0),
        ("displacement", "m", motion.displacement, u, rounding),
    ):
        # Adding 0 avoids a printed -0.
        begin = values[0] + 0.0
        difference = np.abs(begin - start)
        if (difference > CHECKS.start * np.abs(values).max() + slack).any():
            n = int(difference.argmax())
            most = int(np.abs(begin).argmax())
            other = "" if most == n else f"; grain {most + 1} begins with {begin[most]:.6g}"
            return (
                f"grain {n + 1} begins with a {quantity} of {begin[n]:.6g} {unit}, but with "
                f"{start[n]:.6g} in the scene{other}: {CURE}"
            )
    return ""


def _gap_limits(scene: Scene, motion: DumpedMotion, first: FirstFrame) -> Array:
    """Return the uncertainty of each distance between neighbours in the first frame, (N-1,) m."""
    moved = 2 * np.abs(motion.displacement).max()
    limits = CHECKS.overlap * (scene.chain.equilibrium_overlap + moved) + first.slack
    return np.asarray(limits)


def drawn_diameter(scene: Scene, motion: DumpedMotion, first: FirstFrame) -> float:
    """Return the gauge diameter with which all grains are drawn, m; 0 if they have their own.

    Decks that lmpchain writes may draw grains with a diameter of a few overlaps, because heights of
    larger grains would lose digits.
    """
    if not first.drawn or first.depths.size == 1:
        return 0.0
    chain = scene.chain
    diameters = np.diff(first.depths) - np.diff(scene.initial()[0]) + chain.equilibrium_overlap
    gauge = float(diameters.mean())
    spread = 2 * _gap_limits(scene, motion, first).max()
    u = motion.displacement
    overlap = chain.equilibrium_overlap.max() + np.maximum(u[:, :-1] - u[:, 1:], 0.0).max()
    small = 0.0 < gauge < min(chain.diameters.min(), CHECKS.gauge * overlap)
    return gauge if small and np.ptp(diameters) <= spread else 0.0


def _find_gap(scene: Scene, motion: DumpedMotion, first: FirstFrame) -> tuple[str, str]:
    """Return a wrong distance or overlap in the first frame as text, or ""."""
    chain = scene.chain
    if chain.grains == 1:
        return "", ""
    gaps = np.diff(first.depths)
    lengths = chain.contact_lengths[1:-1]
    expected = lengths - chain.equilibrium_overlap + np.diff(scene.initial()[0])
    excess = np.abs(gaps - expected) / _gap_limits(scene, motion, first)
    n = int(excess.argmax())
    if excess[n] <= 1:
        return "", ""
    pair = f"grains {n + 1} and {n + 2}"
    # A smaller difference would not be visible in six digits of a distance.
    if abs(gaps[n] - expected[n]) > CHECKS.distance * lengths[n]:
        distance = (
            f"{pair} are {gaps[n]:.6g} m apart in the first frame, but {expected[n]:.6g} m in the "
            f"scene: {CURE}, and the dump in units si, with xu yu zu if the box is periodic; or "
            "make the scene from the dump with lmpchain new --from"
        )
        return distance, ""
    overlap = (
        f"{pair} overlap by {lengths[n] - gaps[n]:.6g} m in the first frame, but by "
        f"{lengths[n] - expected[n]:.6g} m in the scene: {CURE}, with its diameter, material, load "
        "and gravity; or make the scene from the dump with lmpchain new --from"
    )
    return "", overlap


def check_grains(
    name: str, scene: Scene, columns: Mapping[str, Array], order: np.ndarray, gauge: float
) -> None:
    """Raise `InputError` if radii, diameters or masses in a dump differ from the chain.

    `gauge` is the diameter with which all grains are drawn, m; 0 if grains have their own
    diameters. `order` is the column of the dump for each grain.
    """
    diameters = np.full(order.size, gauge) if gauge else scene.chain.diameters
    for quantity, unit, expected in (
        ("radius", "m", diameters / 2),
        ("diameter", "m", diameters),
        ("mass", "kg", scene.chain.masses),
    ):
        if quantity not in columns:
            continue
        values = columns[quantity][0, order]
        off = np.abs(values / expected - 1)
        n = int(off.argmax())
        if off[n] > CHECKS.grain:
            raise InputError.at(
                name,
                f"grain {n + 1} has a {quantity} of {values[n]:.6g} {unit}, but {expected[n]:.6g} "
                f"{unit} in the scene: {CURE}",
            )


def check_course(
    name: str, scene: Scene, motion: DumpedMotion, steps: int, digit: float, rounding: float
) -> None:
    """Raise `InputError` if the motion is impossible in the scene.

    If the samples resolve the motion, the changes of displacements must equal the integrals of the
    velocities, and the changes of velocities must equal the integrals of the forces over the
    masses. Otherwise the time between two frames or the properties of the grains differ from the
    scene.

    Parameters
    ----------
    name : str
        Name of the dump, for messages.
    scene : Scene
        Scene that the dump should belong to.
    motion : DumpedMotion
        Motion in the dump.
    steps : int
        Number of time steps of the run.
    digit : float
        Size of the last digit of a displacement, m.
    rounding : float
        Rounding error of a height in a time step, m.
    """
    if scene.samples < SAMPLED.fewest:
        return
    interval = scene.sampling_interval
    angle = scene.sampling_phase / 2
    # The tolerance includes the angle cubed: fourth-order integrals have smaller errors. A long
    # step of velocity Verlet changes velocities by a sixth of its angle squared.
    slip = CHECKS.course + (scene.total_phase / steps) ** 2 / 3
    single = angle <= SAMPLED.single
    # Velocities of a driven or forced grain may jump between samples.
    lawful = _lawful(scene)
    # In a vacuum the neighbours of a forced grain may hardly move. Digits of the dump below the
    # accuracy of the solution are ignored.
    digit = max(digit, CHECKS.start * float(np.abs(motion.displacement).max()))
    u = motion.displacement[:, lawful]
    v = motion.velocity[:, lawful]
    masses = scene.chain.masses
    sums = (u, v) if single else _grouped(scene, motion, angle)
    # Steps below the last digit of a height are lost systematically, not at random.
    lost = rounding * steps / scene.intervals
    last = digit + lost * math.sqrt(u.size)
    ratio, doubt = _compare_changes(
        *sums, interval, last if single else last * masses.max() * masses.size
    )
    if _excess(ratio, doubt) > slip + (angle**3 / 2 if single else SAMPLED.leak):
        cure = f"{CURE}, with its duration and as many samples as it has frames"
        raise InputError.at(
            name,
            f"its displacements change {ratio:.3g} times as much from frame to frame as its "
            f"velocities predict for {interval:.6g} s, the sampling interval of the scene: {cure}",
        )
    # Damping forces also depend on velocities, and ground forces may depend on the time.
    if angle > SAMPLED.forces or not scene.chain.conservative:
        return
    acceleration = _accelerations(scene, motion)[:, lawful]
    ratio, doubt = _compare_changes(v, acceleration, interval, 0.0)
    size = float(np.square(acceleration).mean()) if acceleration.any() else np.inf
    # Truncated digits add random accelerations, which the velocities do not show.
    noise = (scene.highest_frequency**2 * digit) ** 2 / size
    if _excess(ratio, doubt) > slip + angle**3 / 2 + noise:
        raise InputError.at(
            name,
            f"its accelerations are {ratio:.3g} times as large as the forces of the scene predict: "
            f"{CURE}, with its diameter, material, load and duration",
        )


def _grouped(scene: Scene, motion: DumpedMotion, angle: float) -> tuple[Array, Array]:
    """Return the momenta of groups of grains that the samples resolve, and their time integrals.

    Forces between the grains of a group cancel, so that the momentum of a larger group changes more
    slowly. The arrays are (T, B), first the integrals, kg m, then the momenta, kg m/s. There are no
    groups, B = 0, if even the whole column moves too fast or if the column is not struck by an
    impulse.
    """
    masses = scene.chain.masses
    u = masses * motion.displacement
    v = masses * motion.velocity
    width = min(math.ceil(SAMPLED.group * angle), masses.size)
    slow = angle * math.sin(math.pi / (2 * width + 2))
    if not isinstance(scene.excitation, Impulse) or slow > SAMPLED.slowest:
        return u[:, :0], v[:, :0]
    starts = width * np.arange(masses.size // width)
    return np.add.reduceat(u, starts, axis=1), np.add.reduceat(v, starts, axis=1)


def _compare_changes(
    values: Array, rates: Array, interval: float, digit: float
) -> tuple[float, float]:
    """Return the ratio of the changes of values to the integrated rates, and its error.

    The ratio is a least-squares fit to all changes from sample to sample, with integrals of fourth
    order in the sampling interval. Its error is the difference from a fit with integrals of second
    order, plus the effect of random rounding errors of the size `digit`. Both arrays are (T, B).
    """
    changes = np.diff(values, axis=0)
    coarse = interval * (rates[1:] + rates[:-1]) / 2
    bent = np.pad(np.diff(rates, 2, axis=0), ((1, 1), (0, 0)), mode="edge")
    fine = coarse - interval * (bent[1:] + bent[:-1]) / 24
    if not (fine.any() and coarse.any()):
        return 1.0, 0.0
    ratios = [float((changes * part).sum() / np.square(part).sum()) for part in (coarse, fine)]
    return ratios[1], abs(ratios[1] - ratios[0]) + 2 * digit / float(np.linalg.norm(fine))


def _excess(ratio: float, doubt: float) -> float:
    """Return the certain excess of a ratio, or of its inverse, above 1, within twice its error."""
    nearest = min(max(1.0, ratio - 2 * doubt), ratio + 2 * doubt)
    return max(nearest, 1 / nearest) - 1 if nearest > 0 else math.inf


def _lawful(scene: Scene) -> np.ndarray:
    """Return the indices of the grains that only the chain accelerates."""
    moving = np.arange(scene.chain.movable)
    return moving[moving != scene.excitation.acts_on - 1]


def _accelerations(scene: Scene, motion: DumpedMotion) -> Array:
    """Return the accelerations of all grains by the forces of their contacts, (T, N) m/s2."""
    wall = scene.excitation.wall
    above = wall.at(scene.time) if wall else None
    contacts = scene.chain.contacts
    forces = contacts.force_change(contacts.closer(motion.displacement, above))
    return np.asarray(-np.diff(forces, axis=1) / scene.chain.masses)
