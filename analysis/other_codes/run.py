"""Time against true error of other codes and the native engine on one scene and machine.

Every code gets the whole chain and is asked for the state at the end; compiling and setting up are
left out, and each time is the smallest of several. Where the chain is much longer than the wave
gets, the solvers of differential equations are run a second time on a chain that was cut by hand,
which those codes do not do, and enters no ratio.
"""

from __future__ import annotations

import os

# One core for all codes; the variable must be set before NumPy is imported.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import json
import math
import platform
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from problem import Answer, Code, Problem, error
from with_native import TO_TOLERANCE

import lmpchain
from lmpchain.benchmark.curves import machine
from lmpchain.benchmark.reference import Reference, reference
from lmpchain.util.files import write_aside

HERE = Path(__file__).parent
OTHERS = "scipy", "numbalsoda", "heyoka", "lammps", "liggghts", "yade"
CUTTABLE = "scipy", "numbalsoda", "heyoka"
TARGETS = 1e-3, 1e-6, 1e-9, 1e-12
LEAST_RUNS, LEAST_S = 3, 0.2  # Least number of runs of each point, and least total time, s.
# Runs longer than the first limit are not repeated; a code stops after a run above the second.
LONG_S = 2.0
LAST_S = 8.0
# Shortest chain that is cut, and relative displacement allowed beyond the cut.
LONG_CHAIN = 1000
UNTOUCHED = 1e-15
# Number of alternating timings of LAMMPS and a code that is added later, and the shortest stored
# LAMMPS time, s, that the timings repeat.
TURNS = 12
YARDSTICK_S = 0.2


def fastest(code: Code, problem: Problem, parameter: float) -> Answer:
    """Return the fastest of several runs, after one to warm up."""
    answer = code.solve(problem, parameter)
    again = []
    begin = perf_counter()
    if answer.seconds > LONG_S:
        return answer
    while len(again) < LEAST_RUNS or perf_counter() - begin < LEAST_S:
        again.append(code.solve(problem, parameter))
    whole = min((run.whole_s for run in again if run.whole_s), default=None)
    return replace(answer, seconds=min(run.seconds for run in again), whole_s=whole)


def scan(code: Code, problem: Problem, solution: Reference) -> list[dict[str, Any]]:
    """Return one row per parameter, without failed runs, up to the first that is too slow."""
    begin = perf_counter()
    rows = []
    gaps = []
    for parameter in code.parameters:
        try:
            answer = fastest(code, problem, parameter)
        except (
            lmpchain.LmpchainError
        ) as reason:  # The step is unstable, or the tolerance unreachable.
            gaps.append(str(reason).strip().splitlines()[-1])
            continue
        row = {"code": code.name, "parameter": parameter, "error": error(answer, solution),
               "seconds": answer.seconds,
               "force_evaluations": answer.force_evaluations,
               "whole_s": answer.whole_s}  # fmt: skip
        if row["error"] < 1:
            rows.append(row)
        if answer.seconds > LAST_S:
            break
    failed = f"; {len(gaps)} failed, the last one: {gaps[-1]}" if gaps else ""
    name = f"{code.name}, {problem.scene.chain.grains} grains"
    print(f"{name}: {perf_counter() - begin:.0f} s, {len(rows)} points{failed}", flush=True)
    return rows


def cut_of(problem: Problem, solution: Reference) -> Problem | None:
    """Return the problem without the grains that the wave does not reach, or None if few."""
    grains = problem.scene.chain.grains
    u = np.abs(solution.displacement[-1])
    needed = int(np.flatnonzero(u > UNTOUCHED * u.max())[-1]) + 8
    return problem.cut(needed) if grains > LONG_CHAIN and needed < grains / 2 else None


def measure(scene: lmpchain.Scene, others: list[str]) -> dict[str, Any]:
    """Run all codes on a scene."""
    problem = Problem(scene)
    solution = reference(problem.scene)
    cut = cut_of(problem, solution)
    rows = []
    rows_cut = []
    versions = {name: version(name) for name in ("lmpchain", "numpy", "numba")} | {
        "python": platform.python_version()
    }
    for other in ("native", *others):
        try:
            module = import_module(f"with_{other}")
        except ImportError as missing:
            print(f"{other} is left out: {missing}")
            continue
        todo = [(code, problem, rows) for code in module.codes(problem)]
        if cut and other in CUTTABLE:
            todo += [(code, cut, rows_cut) for code in module.codes(cut)]
        for code, given, collected in todo:
            collected += scan(code, given, solution)
            versions[other] = code.version
    return {
        "machine": f"{machine()}, load {os.getloadavg()[0]:.1f}",
        "versions": versions,
        "reference_error": solution.error,
        "rows": rows,
        "rows_cut": rows_cut,  # The chain cut by hand.
    }


def add(scene: lmpchain.Scene, others: list[str], kept: dict[str, Any]) -> dict[str, Any]:
    """Run other discrete element codes, and add their results to an existing file.

    Each code and LAMMPS are timed alternately in CPU time, so that the machine may be busy. The
    time of a step is the ratio of both times, multiplied by the stored LAMMPS time of a step.
    """
    problem = Problem(scene)
    solution = reference(problem.scene)
    (yardstick,) = import_module("with_lammps").codes(problem)
    known = [row for row in kept["rows"] if row["code"] == yardstick.name]
    then = next((row for row in known if row["seconds"] > YARDSTICK_S), known[-1])
    for other in others:
        for code in import_module(f"with_{other}").codes(problem):
            pairs = [
                [one.solve(problem, then["parameter"]).seconds for one in (yardstick, code)]
                for _ in range(TURNS)
            ]
            now, its = np.min(pairs, axis=0).tolist()
            rows = scan(code, problem, solution)
            step_s = its / now * then["seconds"] / then["force_evaluations"]
            for row in rows:
                row["seconds"] = step_s * row["force_evaluations"]
            kept["rows"] = [row for row in kept["rows"] if row["code"] != code.name] + rows
            kept["versions"][other] = code.version
            kept.setdefault("added", {})[code.name] = {
                "machine": f"{machine()}, load {os.getloadavg()[0]:.1f}",
                "over_lammps": its / now,
                "lammps_now_over_then": now / then["seconds"],
            }
    return kept


def table(result: dict[str, Any]) -> str:
    """Return the time to each error, and the ratio of the fastest other code to native."""
    points = _by_code(result["rows"])
    whole = [{**row, "seconds": row["whole_s"]} for row in points.get(TO_TOLERANCE, [])]
    chosen = points.get(TO_TOLERANCE, [])
    given = [
        row
        for name, rows in points.items()
        if name.startswith("native") and name != TO_TOLERANCE
        for row in rows
    ]
    others = [row for name, rows in points.items() if not name.startswith("native") for row in rows]
    lammps = [row for row in others if row["code"].startswith("LAMMPS")]
    lines = [
        "| µs to an error of | " + " | ".join(f"{target:.0e}" for target in TARGETS) + " |",
        "|---" * 5 + "|",
    ]
    cut = {f"{name}, cut by hand": rows for name, rows in _by_code(result["rows_cut"]).items()}
    for name, rows in (points | {f"{TO_TOLERANCE}, the whole call": whole} | cut).items():
        lines.append(_line(name, [1e6 * _time_to(rows, target) for target in TARGETS]))
    for label, ours in (("native", given), (TO_TOLERANCE, chosen)):
        for who, theirs in (
            ("best of the others", others),
            ("LAMMPS", lammps),
            ("best, cut by hand", result["rows_cut"]),
        ):
            ratios = [_time_to(theirs, target) / _time_to(ours, target) for target in TARGETS]
            lines.append(_line(f"{who} / {label}", ratios))
    return "\n".join(lines)


def _by_code(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    names = dict.fromkeys(row["code"] for row in rows)
    return {name: [row for row in rows if row["code"] == name] for name in names}


def _time_to(rows: list[dict[str, Any]], target: float) -> float:
    return min((row["seconds"] for row in rows if row["error"] <= target), default=math.nan)


def _line(name: str, values: list[float]) -> str:
    return (
        f"| {name} | "
        + " | ".join(f"{float(f'{x:.3g}'):,.10g}" if math.isfinite(x) else "-" for x in values)
        + " |"
    )


def main() -> None:
    """Read the scene, measure, print the table and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "scene", type=Path, help="a scene file; only the state at its end is asked for"
    )
    parser.add_argument("--codes", default=",".join(OTHERS), help="some of " + ",".join(OTHERS))
    parser.add_argument(
        "--add", action="store_true", help="add codes of discrete elements to those in the file"
    )
    given = parser.parse_args()
    others = [name for name in given.codes.split(",") if name]
    if unknown := set(others) - set(OTHERS):
        parser.error(
            f"--codes: there is no {', '.join(sorted(unknown))}; take some of {', '.join(OTHERS)}"
        )
    path = HERE / f"{given.scene.stem}.json"
    try:
        scene = lmpchain.Scene.from_toml(given.scene)
        if given.add:
            result = add(scene, others, json.loads(path.read_text(encoding="utf-8")))
        else:
            result = measure(scene, others)
    except lmpchain.InputError as faults:
        parser.error(str(faults))
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"\n{given.scene.stem}: {result['machine']}; {result['versions']}")
    print(f"The reference is known to {result['reference_error']:.0e}.\n\n{table(result)}")


if __name__ == "__main__":
    main()
