"""Random scenes for every engine, compared with an independent integrator, each from a seed.

    PYTHONPATH=tests python -m validation.random_trials native 0:5000 --output native.jsonl
    PYTHONPATH=tests python -m validation.random_trials native 17
    PYTHONPATH=tests python -m validation.random_trials --table native.jsonl auto.jsonl

Every trial says how far the answer is from the truth, relative to the largest motion at any time of
the run, what the engine estimated, and whether that is right. A range may be cut in pieces that run
side by side; seeds that the output holds already are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from helpers import extrapolated_midpoint, taylor_series
from helpers.taylor_series import Reference, Unresolved
from helpers.trial_laws import law_trial
from helpers.trial_scenes import (
    acted_trial_scene,
    damped,
    loose_trial_scene,
    short_damped_scene,
    trial_scene,
)

from lmpchain import InputError, RunFailed, Scene, ToleranceNotMet, Trajectory, simulate
from lmpchain.engines.native import Native

LONGEST = 60.0  # CPU time, s; a longer trial counts as a failure.
LOW = 3.0  # An estimate below a third of the true error is a failure.
ROUND = 2.3e-16  # Difference of two solutions in double precision.
SAFE = 10.0  # The error of the reference must be smaller than its margin by this factor.
FAMILIES = (
    *("native", "step", "auto", "linear", "lammps", "acted"),
    *("damped", "damped-lammps", "loose", "damped-short", "law"),
)
# Smallest reasonable tolerance.
LOOSE = {
    "verlet": 1e-7,
    "gear4": 1e-8,
    "rkn4": 1e-11,
    "kahan-li6": 1e-12,
}
ENDINGS = ("right", "above", "missed", "refused", "failed", "slow", "unresolved")


class TooLong(BaseException):
    """Raised after a minute; not an exception that a handler may take for a failed run."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise `TooLong` after this CPU time of the process, however busy the machine is.

    0 is no limit.
    """

    def stop(*_: object) -> None:
        raise TooLong

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def compile_all() -> None:
    """Compile all loops, because compilation is not part of the time of a trial."""
    scene = trial_scene(np.random.default_rng(1), (1.5,), 100.0)
    for integrator in Native.integrators:
        simulate(scene, "native", 0.01, on_miss="warn", integrator=integrator)
    for exponent in (1.0, 1.5, 2.0, 2.5, 3.0):
        for seed in range(4):
            scene = trial_scene(np.random.default_rng(seed), (exponent,), 100.0)
            simulate(scene, "native", 0.01, on_miss="warn")
            simulate(scene, "auto", 0.01, on_miss="warn")


def draw(family: str, seed: int) -> tuple[Scene, str, float, dict[str, Any]]:
    """Return scene, engine, tolerance and options of a trial."""
    rng = np.random.default_rng([FAMILIES.index(family), seed])
    tolerance = float(10 ** rng.uniform(-13, -2))
    engine = family
    options = {}
    work = 10 ** rng.uniform(3, 5.3)
    match family:
        case "native" | "step":
            integrator = rng.choice(
                ["auto"] * 6
                + ["rkn6", "rkn4", "kahan-li8", "kahan-li6", "dop853", "gear4", "verlet"]
            )
            options = {"integrator": integrator.item()}
            if rng.random() < 0.1:
                options["force"] = "exact"
            if family == "native" and rng.random() < 0.1:
                options["adaptive"] = False
            least = LOOSE.get(options["integrator"], 0.0)
            if tolerance < least:
                tolerance = least * 10 ** rng.uniform(0, 3)
            if least >= 1e-8:
                work /= 10
            scene = trial_scene(rng, work=work)
            if family == "step":
                engine = "native"
                options["step"] = float(10 ** rng.uniform(-2, 0.3) / scene.highest_frequency)
        case "auto":
            scene = trial_scene(rng, work=work)
        case "acted":
            engine = rng.choice(["auto", "native"]).item()
            scene = acted_trial_scene(rng, work=work)
        case "damped":
            engine = rng.choice(["auto", "native"]).item()
            acted = rng.random() < 0.5
            scene = acted_trial_scene(rng, work=work) if acted else trial_scene(rng, work=work)
            scene = damped(rng, scene)
        case "damped-short":
            engine = "native"
            tolerance = float(10 ** rng.uniform(-11, -3))
            scene = short_damped_scene(rng)
        case "law":
            engine = "native"
            tolerance = float(10 ** rng.uniform(-11, -3))
            scene = law_trial(rng)
        case "loose":
            engine = rng.choice(["auto", "native"]).item()
            tolerance = float(10 ** rng.uniform(-11, -3))
            scene = loose_trial_scene(rng, 10 ** rng.uniform(2.3, 4.3))
        case "damped-lammps":
            engine = "lammps"
            tolerance = float(10 ** rng.uniform(-4, -1.5))
            scene = damped(rng, trial_scene(rng, (1.0, 1.5, 1.5, 1.5), work / 30), alike=True)
        case "linear":
            engine = rng.choice(["modes", "chebyshev", "bessel", "continuum"]).item()
            scene = trial_scene(rng, work=work)
        case _:
            tolerance = float(10 ** rng.uniform(-9, -2))
            options = {"integrator": rng.choice(["rkn6", "rkn6", "kahan-li6"]).item()}
            if rng.random() < 0.2:
                options = {"integrator": "verlet"}
                tolerance = float(10 ** rng.uniform(-5, -2))
            scene = trial_scene(rng, (1.0, 1.5, 1.5, 1.5), work / 10)
    return scene, engine, tolerance, options


def trial(family: str, seed: int, longest: float = 0.0) -> dict[str, Any]:
    """Return the result of a trial as a row of the table.

    It is given up after `longest` s of this process.
    """
    scene, engine, tolerance, options = draw(family, seed)
    chain = scene.chain
    row: dict[str, Any] = {
        "family": family, "seed": seed, "engine": engine, "tolerance": tolerance, **options,
        "grains": chain.grains, "law": repr(chain.law), "top": chain.top,
        "bottom": chain.bottom,
        "pressed": chain.compressed, "kind": scene.excitation.kind, "samples": scene.samples,
        "number": scene.strike_number, "angle": scene.highest_frequency * scene.duration,
    }  # fmt: skip
    began = time.process_time()
    answer = None
    reason = ""
    try:
        with within(longest), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            answer = simulate(scene, engine, tolerance, **options)
    except TooLong:
        row["ending"] = "slow"
    except InputError as error:
        row["ending"] = "refused"
        reason = str(error)
    except ToleranceNotMet as error:
        row["ending"] = "missed"
        reason = error.reason
        answer = error.trajectory
    except RunFailed as error:
        row["ending"] = "refused" if "step" in options else "failed"
        reason = str(error)
    except Exception as error:
        row["ending"] = "failed"
        reason = f"{type(error).__name__}: {error}"
    row |= {"seconds": time.process_time() - began, "said": len(said), "reason": reason[:300]}
    if row.get("ending") in ("slow", "refused", "failed"):
        return row
    began = time.process_time()
    row |= judge(
        scene, engine, tolerance, answer, missed="ending" in row, fixed=family in ("step", "linear")
    )
    return row | {"reference_s": time.process_time() - began}


def solver_of(scene: Scene) -> Any:
    """Return the module with the independent integrator for the law of this scene."""
    by_formula = scene.chain.given_law in extrapolated_midpoint.TERMS
    return extrapolated_midpoint if by_formula else taylor_series


def judge(
    scene: Scene,
    engine: str,
    tolerance: float,
    answer: Trajectory | None,
    missed: bool = False,
    fixed: bool = False,
) -> dict[str, Any]:
    """Compare a run with references of increasing accuracy until the verdict is clear.

    One against it takes two of them.
    """
    row: dict[str, Any] = {"ending": "missed" if missed else "unresolved"}
    if answer is not None:
        estimate = answer.error_estimate.total
        row |= {"estimate": estimate, "solver": answer.error_estimate.solver,
                "method": answer.cost.integrator,
                "answered": answer.engine, "steps": answer.cost.steps}  # fmt: skip
    solver = solver_of(scene)
    finest = solver.FINEST["long double"]
    tried = max(finest, 1e-4 * tolerance)
    against = False
    while True:
        try:
            true, doubt = solver.reference(scene, tried)
        except Unresolved as error:
            return row | {"ending": "missed" if missed else "unresolved", "why": str(error)}
        row |= {"doubt": doubt, "events": true.events}
        clear = missed and doubt < tolerance / 30
        if answer is not None:
            # An unpredictable run ends at its predictability horizon.
            off = true.until(answer.time.size).error(answer.displacement, answer.velocity)
            row |= {"true": off, "ratio": estimate / off if off else np.inf,
                    "above": off - doubt > tolerance,
                    "low": off - doubt - ROUND > LOW * estimate}  # fmt: skip
            sure = [
                abs(off - tolerance) > SAFE * doubt,
                abs(off - LOW * estimate - ROUND) > SAFE * doubt or off < ROUND,
            ]
            clear |= all(sure[fixed:]) or doubt < ROUND
        confirmed = against
        against = clear and bool(row.get("above") or row.get("low"))
        if (clear and (confirmed or not against)) or tried <= finest:
            break
        tried = max(finest, 1e-4 * tried)
    if not clear:
        return row | {"low": False}
    if missed:
        return row | {"possible": possible(scene, true, tolerance, engine)}
    return row | {"ending": "above" if row["above"] and not fixed else "right"}


def possible(scene: Scene, true: Reference, tolerance: float, engine: str) -> bool:
    """Return whether a third of the tolerance can be met.

    By the independent integrator in plain double precision.

    LAMMPS, which holds heights, is held to what it does itself if it is told to go on.
    """
    if engine == "lammps":
        try:
            with warnings.catch_warnings(action="ignore"), within(LONGEST):
                answer = simulate(scene, engine, tolerance, on_miss="warn")
        except (ToleranceNotMet, RunFailed, TooLong):
            return False
        if answer.time.size < scene.samples:
            return False
        return true.error(answer.displacement, answer.velocity) < tolerance / 3
    solver = solver_of(scene)
    try:
        plain = solver.solve(scene, max(solver.FINEST["double"], 1e-4 * tolerance), "double")
    except Unresolved:
        return False
    return true.error(plain.displacement, plain.velocity) < tolerance / 3


def table(rows: Iterable[dict[str, Any]]) -> str:
    """Return the counts of the outcomes of trials, and the seeds that failed."""
    rows = list(rows)
    lines = [
        "family   trials   "
        + "  ".join(f"{e:>10}" for e in (*ENDINGS, "low", "false miss", "> 10 s"))
    ]
    for family in FAMILIES:
        these = [row for row in rows if row["family"] == family]
        counts = Counter(row["ending"] for row in these)
        counts["low"] = sum(bool(row.get("low")) for row in these)
        counts["false miss"] = sum(bool(row.get("possible")) for row in these)
        counts["> 10 s"] = sum(row["seconds"] > 10 for row in these)
        if these:
            lines.append(
                f"{family:8} {len(these):6}   "
                + "  ".join(f"{counts[e]:10}" for e in (*ENDINGS, "low", "false miss", "> 10 s"))
            )
    for row in rows:
        faults = [e for e in ("above", "failed", "slow") if row["ending"] == e]
        faults += ["low"] * bool(row.get("low")) + ["false miss"] * bool(row.get("possible"))
        if faults:
            lines.append(summary(row, faults))
    return "\n".join(lines)


def summary(row: dict[str, Any], faults: Iterable[str] = ()) -> str:
    """Return a one-line summary of a trial."""
    numbers = "  ".join(
        f"{key} {row[key]:.2g}" for key in ("tolerance", "true", "estimate", "doubt") if key in row
    )
    method = f"{row.get('integrator', '')}({row.get('method', '')}){' h' if 'step' in row else ''}"
    what = (
        f"N={row['grains']} {row['law'][:60]} {row['top']}/{row['bottom']} {row['kind']} "
        f"number={row['number']:.2g} angle={row['angle']:.2g} T={row['samples']} {method} "
        f"steps={row.get('steps', '?')} events={row.get('events', '?')}"
    )
    ending = "+".join(faults) or row["ending"]
    return (
        f"{row['family']} {row['seed']}: {ending}; {numbers}; {what}; {row['seconds']:.1f} s "
        f"{row['reason'][:90]}"
    )


def main() -> None:
    """Run trials, or print the table of finished trials."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("family", nargs="?", choices=FAMILIES)
    parser.add_argument("seeds", nargs="?", help="FIRST:END, or one")
    parser.add_argument(
        "--output", type=Path, help="file to which a line of JSON is added for each trial"
    )
    parser.add_argument("--table", type=Path, nargs="+", help="files whose trials to count")
    asked = parser.parse_args()
    if asked.table:
        print(
            table(
                json.loads(line) for path in asked.table for line in path.read_text().splitlines()
            )
        )
        return
    first, _, end = asked.seeds.partition(":")
    done = set()
    if asked.output and asked.output.exists():
        done = {json.loads(line)["seed"] for line in asked.output.read_text().splitlines()}
    compile_all()
    rows = []
    for seed in range(int(first), int(end or int(first) + 1)):
        if seed in done:
            continue
        rows.append(row := trial(asked.family, seed, LONGEST))
        if asked.output:
            with open(asked.output, "a") as opened:
                opened.write(json.dumps(row, default=lambda value: value.item()) + os.linesep)
        else:
            print(summary(row))
    print(table(rows))


if __name__ == "__main__":
    main()
