"""Commands that set engines beside the truth: compare, workprec, stability, doctor."""

from __future__ import annotations

import argparse
import sys
import warnings
from typing import TYPE_CHECKING

from ..errors import EngineUnavailable, InputError, RunFailed, ToleranceNotMet, check_tolerance
from .common import PICTURES, beside, complain, gather, keep, output, read, write_json

if TYPE_CHECKING:
    from ..benchmark.reference import Reference
    from ..scene.scene import Scene
    from ..trajectory.trajectory import Trajectory

REFERENCE_S = 60.0  # longest expected time for the independent reference; the native engine takes over beyond it
TIGHTEST = 1e-11  # tolerance that the native engine reaches on every ordinary scene


def compare(arguments: argparse.Namespace) -> int:
    """Answer a scene with several engines and set them beside the truth."""
    names, scene, picture, numbers, _ = gather(
        lambda: _names(arguments.engines),
        lambda: read(arguments.scene),
        lambda: arguments.output and output(arguments.output, arguments.scene, PICTURES),
        lambda: arguments.json and output(arguments.json, arguments.scene),
        lambda: check_tolerance(arguments.tolerance),
    )
    from .. import engines
    from ..benchmark.comparison import compare as side_by_side

    able: list[str] = []
    refusals: list[tuple[str, str]] = []
    for name in names:
        reasons = engines.get(name).refuses(scene)
        refusals += [(key, f"{name}: {reason}") for key, reason in reasons]
        if not reasons:
            able.append(name)
    if not able:
        raise InputError(refusals)
    trajectories, failures = _answers(scene, able, arguments.tolerance)
    if trajectories:
        comparison = side_by_side(trajectories, _reference(scene, arguments.tolerance))
        print(comparison.table())
    for key, reason in refusals:
        print(f"left out: {reason} ({key})")
    if trajectories:
        keep(comparison, numbers, picture)
    for failure in failures:
        complain(failure)
    return 1 if failures else 0


def _names(given: str | None) -> list[str]:
    from .. import engines

    if given is None:
        return list(engines.names())
    chosen = list(dict.fromkeys(name.strip() for name in given.split(",") if name.strip()))
    known = ", ".join(engines.names())
    if faults := [("engines", f"no engine is called {n!r}; use {known}") for n in chosen if n not in engines.names()]:
        raise InputError(faults)
    if not chosen:
        raise InputError([("engines", f"names none; use {known}")])
    return chosen


def _answers(scene: Scene, names: list[str], tolerance: float) -> tuple[list[Trajectory], list[str]]:
    """Run every engine; return the answers and what went wrong, in words."""
    from ..simulation.api import simulate

    trajectories, failures = [], []
    for name in names:
        try:
            with warnings.catch_warnings(action="ignore"):  # how far off an answer is stands in the table
                trajectories.append(simulate(scene, name, tolerance, progress=sys.stderr.isatty()))
        except ToleranceNotMet as error:
            failures.append(f"{name}: {error.reason}")
            if error.trajectory is not None:
                trajectories.append(error.trajectory)
        except (RunFailed, EngineUnavailable) as error:
            failures.append(f"{name}: {error}")
    return trajectories, failures


def _reference(scene: Scene, tolerance: float) -> Reference:
    """Return the truth: from an integrator apart, or from the native engine where that would take too long."""
    from ..benchmark.reference import Reference, expected_seconds, reference
    from ..scene.scene import Scene
    from ..simulation.api import simulate

    if expected_seconds(scene) <= REFERENCE_S:
        return reference(scene)
    tight = max(tolerance / 100, TIGHTEST)
    everywhere = Scene(chain=scene.chain, excitation=scene.excitation, duration=scene.duration, samples=scene.samples)
    try:
        truth = simulate(everywhere, "native", tight, progress=sys.stderr.isatty())
    except ToleranceNotMet as error:
        if error.trajectory is None:
            raise
        truth = error.trajectory
    method = f"the native engine at a tolerance of {tight:g} (too long a scene for an integrator apart)"
    return Reference(truth.time, truth.displacement, truth.velocity, truth.error_estimate.total, method)


def workprec(arguments: argparse.Namespace) -> int:
    """Chart the speed of every engine and integrator against its accuracy on a scene."""
    json = arguments.json or (arguments.output and beside(arguments.output, ".json"))
    scene, picture, numbers = gather(
        lambda: read(arguments.scene),
        lambda: arguments.output and output(arguments.output, arguments.scene, PICTURES),
        lambda: json and output(json, arguments.scene),
    )
    from ..benchmark.bench import work_precision

    found = work_precision(scene, arguments.budget, progress=sys.stderr.isatty())
    print(found.table())
    for reason in found.left_out:
        print(f"left out: {reason}")
    keep(found, numbers, picture)
    return 0


def stability(arguments: argparse.Namespace) -> int:
    """Find where methods fail on a scene."""
    scene, picture, numbers = gather(
        lambda: read(arguments.scene),
        lambda: arguments.output and output(arguments.output, arguments.scene, PICTURES),
        lambda: arguments.json and output(arguments.json, arguments.scene),
    )
    from ..stability.find import stability as found_out

    found = found_out(scene, progress=sys.stderr.isatty())
    print(found.table())
    for reason in found.left_out:
        print(f"left out: {reason}")
    keep(found, numbers, picture)
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """Say what works here, finding by finding; a fault makes it fail."""
    path = arguments.json and output(arguments.json, "")
    from ..doctor import diagnose

    diagnosis = diagnose(tell=lambda finding: print(finding, flush=True))
    print(diagnosis.summary)
    if path:
        write_json(diagnosis.to_json(), path)
        print(f"findings: {path}")
    return 1 if diagnosis.counts["fault"] else 0
