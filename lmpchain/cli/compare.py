"""Commands that compare engines: compare, workprec, stability, doctor, check."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import (
    EngineUnavailable,
    InputError,
    RunFailed,
    ToleranceNotMet,
    check_tolerance,
    shown,
)
from ..util.remarks import warnings_aside
from ..util.tables import wrap
from .common import (
    PICTURES,
    beside,
    check_numbers,
    check_outputs,
    collect,
    complain,
    keep,
    on_terminal,
    output,
    read_scene,
    show,
    write_json,
)

if TYPE_CHECKING:
    from ..benchmark.curves import WorkPrecision
    from ..doctor import Finding
    from ..scene.scene import Scene
    from ..stability.result import Stability
    from ..trajectory.trajectory import Trajectory

SHORT_S = 2.0  # Runs shorter than this time are repeated, s.


def compare(arguments: argparse.Namespace) -> int:
    """Solve a scene with several engines and compare them with a reference solution."""
    from ..util.validation import check_positive

    names, scene, picture, numbers, _, _ = collect(
        lambda: _names(arguments.engines),
        lambda: read_scene(arguments.scene),
        *check_outputs(arguments, arguments.scene),
        lambda: check_tolerance(arguments.tolerance),
        lambda: check_positive("budget", arguments.budget),
    )
    from ..benchmark import comparison
    from ..benchmark.truth import thin_trace, truth
    from ..engines.cost_model import budget

    engines_of_scene, refusals = _able(names, scene)
    with budget(arguments.budget):
        scene, remark = thin_trace(scene, arguments.tolerance)
    tolerances = dict.fromkeys(engines_of_scene, arguments.tolerance)
    trajectories, failures, remarks = _run_engines(scene, tolerances, arguments.budget)
    beginning = min((each.scene for each in trajectories), key=_count_samples, default=scene)
    if beginning.samples < scene.samples:
        # If a scene cannot be predicted to its end, its predictable part is compared.
        scene = scene.replace(duration=beginning.duration, samples=beginning.samples)
        tolerances = {each.engine: tolerances[each.engine] for each in trajectories}
        trajectories, _, shorter = _run_engines(scene, tolerances, arguments.budget)
        remarks += shorter
    if trajectories:
        solution = truth(scene, arguments.tolerance, progress=on_terminal())
        lossless = _lossless(scene, arguments.tolerance, arguments.budget)
        result = comparison.compare(trajectories, solution, lossless)
        print(result.table())
    _print_lines(
        *wrap(*filter(None, [remark, *remarks])),
        *(f"left out: {name}: {why}" for name, why in refusals.items()),
    )
    if trajectories:
        keep(result, numbers, picture)
    for failure in failures:
        complain(failure)
    return 1 if failures or not trajectories else 0


def _able(names: list[str], scene: Scene) -> tuple[list[str], dict[str, str]]:
    """Return the engines that support a scene, and the main reason against each other engine.

    Raises
    ------
    InputError
        If none of the engines supports the scene.
    """
    from .. import engines

    reasons = {name: engines.obstacles(engines.get(name), scene) for name in names}
    able = [name for name in names if not reasons[name]]
    if not able:
        raise InputError([(key, f"{name}: {why}") for name in names for key, why in reasons[name]])
    refused = {name: engines.brief(name, why[0][1]) for name, why in reasons.items() if why}
    return able, refused


def _print_lines(*lines: str) -> None:
    """Print lines, if there are any."""
    for line in lines:
        print(line)


def _count_samples(scene: Scene) -> int:
    return scene.samples


def _names(given: str | None) -> list[str]:
    from .. import engines

    if given is None:
        return list(engines.names())
    names = list(dict.fromkeys(name.strip() for name in given.split(",") if name.strip()))
    cure = f"use {', '.join(engines.names())}"
    if faults := [
        ("engines", f"no engine is called {shown(name)}; {cure}")
        for name in names
        if name not in engines.names()
    ]:
        raise InputError(faults)
    if not names:
        raise InputError.at("engines", f"names none; {cure}")
    return names


def _run_engines(
    scene: Scene, tolerances: dict[str, float], budget_s: float
) -> tuple[list[Trajectory], list[str], list[str]]:
    """Run every engine; return the trajectories, the failures and the warnings.

    If an engine would exceed the budget, in s, its entry in `tolerances` is multiplied by ten until
    a run fits the budget. The engine is left out if this needs a tolerance of 1 or more. The budget
    includes all attempts of an engine.
    """
    from ..engines.cost_model import TooLong, budget

    trajectories = []
    failures = []
    remarks = []
    for name, asked in tolerances.items():
        reason = ""
        try:
            with budget(budget_s):
                while tolerances[name] < 1 or not reason:
                    try:
                        trajectories.append(_run(scene, name, tolerances[name], budget_s))
                        break
                    except TooLong as excess:
                        reason = reason or str(excess)
                        tolerances[name] *= 10
        except ToleranceNotMet as error:
            failures.append(f"{name}: {error.reason}")
            if error.trajectory is not None:
                trajectories.append(error.trajectory)
        except (RunFailed, EngineUnavailable) as error:
            failures.append(f"{name}: {error}")
        if reason:
            ran = f"with a tolerance of {tolerances[name]:.2g}"
            done = f"ran {ran} and not {asked:.2g}"
            if tolerances[name] >= 1:
                done = "left out at any tolerance"
            remarks.append(
                f"{name}: {done}, because {reason}, above the budget of {budget_s:g} s; "
                "--budget SECONDS allows more"
            )
    return trajectories, failures, remarks


def _run(scene: Scene, name: str, tolerance: float, budget_s: float) -> Trajectory:
    """Return the trajectory of an engine, with the time of the fastest of several short runs.

    Short runs are repeated, because the first run also loads compiled code.
    """
    from ..engines.cost_model import budget
    from ..simulation.api import simulate

    # The table lists the errors, so warnings are suppressed.
    with warnings_aside():
        with budget(budget_s):
            answer = simulate(scene, name, tolerance, progress=on_terminal())
        if answer.cost.total_s >= SHORT_S:
            return answer
        quickest = _quickest(scene, name, tolerance)
        return replace(answer, cost=answer.cost._replace(integration_s=quickest))


def _lossless(scene: Scene, tolerance: float, budget_s: float) -> Trajectory | None:
    """Return the run of a damped scene without its damping, if an engine supports it."""
    from ..engines.cost_model import TooLong, budget
    from ..simulation.api import simulate

    if not scene.chain.damped:
        return None
    conservative = scene.replace(chain=scene.chain.replace(damping=None))
    try:
        with warnings_aside(), budget(budget_s):
            return simulate(conservative, "native", tolerance)
    except (ToleranceNotMet, RunFailed, TooLong):
        return None


def _quickest(scene: Scene, name: str, tolerance: float) -> float:
    """Return the time of the fastest of several runs, s."""
    from ..benchmark.bench import repeat
    from ..simulation.api import simulate

    costs = repeat(lambda: simulate(scene, name, tolerance).cost)
    return min(cost.integration_s for cost in costs)


def workprec(arguments: argparse.Namespace) -> int:
    """Plot the cost of every engine and integrator against its accuracy on a scene."""
    json = arguments.json or (arguments.output and beside(arguments.output, ".json"))
    scene, picture, numbers = collect(
        lambda: read_scene(arguments.scene),
        lambda: (
            arguments.output
            and output(arguments.output, arguments.scene, PICTURES, force=arguments.force)
        ),
        lambda: json and output(json, arguments.scene, force=arguments.force, stream=True),
    )
    from ..benchmark.bench import work_precision

    result = work_precision(scene, arguments.budget, progress=on_terminal())
    _show(result, numbers, picture)
    return 0


def stability(arguments: argparse.Namespace) -> int:
    """Find the step sizes at which methods become unstable on a scene."""
    scene, picture, numbers = collect(
        lambda: read_scene(arguments.scene),
        *check_outputs(arguments, arguments.scene),
    )
    from ..stability import find

    result = find.stability(scene, progress=on_terminal())
    _show(result, numbers, picture)
    return 0


def _show(result: WorkPrecision | Stability, numbers: Path | None, picture: Path | None) -> None:
    """Print the table of a result and the omitted engines; write numbers and picture."""
    print(result.table())
    for reason in result.left_out:
        print(f"left out: {reason}")
    keep(result, numbers, picture)


def _show_finding(finding: Finding) -> None:
    show(finding.state, str(finding).removeprefix(finding.state), sys.stdout)


def doctor(arguments: argparse.Namespace) -> int:
    """Check the installation and print each finding; a fault sets the exit code."""
    path = check_numbers(arguments, "")
    from ..doctor import compile_all, diagnose

    if arguments.compile:
        compile_all(progress=on_terminal())
    diagnosis = diagnose(tell=_show_finding)
    print(diagnosis.summary)
    if path:
        write_json(diagnosis.to_json(), path, "findings")
    return 1 if diagnosis.counts["fault"] else 0


def check(arguments: argparse.Namespace) -> int:
    """Print the true error of a run, its causes and cures; exit code 1 if it misses a tolerance."""
    subject = arguments.run or arguments.deck
    if not subject or (arguments.run and arguments.deck):
        raise InputError.at("run", "give either a dump or saved run, or --deck FOLDER")
    scene, numbers, _ = collect(
        lambda: arguments.scene and read_scene(arguments.scene),
        lambda: check_numbers(arguments, arguments.scene or subject),
        lambda: check_tolerance(0.5 if arguments.tolerance is None else arguments.tolerance),
    )
    from ..benchmark.own_run import check, check_deck

    if arguments.deck and arguments.units:
        raise InputError.at("units", "is only for a LAMMPS dump: leave it out for a deck")
    if arguments.deck:
        result = check_deck(subject, scene, progress=on_terminal())
    else:
        result = check(subject, scene, units=arguments.units, progress=on_terminal())
    print(result.table())
    keep(result, numbers, None)
    return int(arguments.tolerance is not None and result.exceeds(arguments.tolerance))
