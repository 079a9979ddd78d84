"""Scaling of the cost with the number of grains, chains, threads and MPI ranks.

Grain-steps (evaluations of the force, times grains) in a second of integration, in chains that move
everywhere, so that none of them is left out: every grain is given a random velocity, weak enough
that no contact opens. Beside it the time from nothing to the answer for a strike on grain 1, where
grains that no wave has reached cost nothing, and a thousand random chains shared out over threads.
Each number is the best of several runs, taken in turn.
"""

from __future__ import annotations

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from figures import arguments, finish, legends

import lmpchain
from lmpchain.benchmark.curves import machine
from lmpchain.disorder.averages import ensemble
from lmpchain.engines import Lammps, Native
from lmpchain.util.files import write_aside
from lmpchain.util.plotting import COLOURS, figure, look_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRENGTH = 0.03  # Size of the velocities as a strike number v0*.
PHASE = 0.1  # Phase of the deepest contact per step, rad.
WORK = {"native": 1e9, "lammps": 2e6}  # Largest number of grain-steps of a run.
STEPS = {"native": 2_000_000, "lammps": 2000}
RUNS = 3
THREADS = (1, 2)
LENGTHS = (1000, 100_000)  # Numbers of steps of the chains of an ensemble.
ENGINES: dict[str, Callable[[float], Any]] = {
    "native verlet": lambda step: Native(integrator="verlet", step=step),
    "native rkn6": lambda step: Native(integrator="rkn6", step=step),
    "lammps verlet, 1 rank": lambda step: Lammps(integrator="verlet", step=step),
    "lammps verlet, 2 ranks": lambda step: Lammps(integrator="verlet", step=step, ranks=2),
}
LAMMPS: dict[str, Any] = {"color": COLOURS["vermilion"], "ls": "--"}
STYLES: dict[str, dict[str, Any]] = {
    "native verlet": look_of("verlet"),
    "native rkn6": look_of("rkn6"),
    "lammps verlet, 1 rank": LAMMPS | {"marker": "o", "mfc": "w"},
    "lammps verlet, 2 ranks": LAMMPS | {"marker": "o"},
}
Row = dict[str, Any]


def stirred(grains: int, steps: int) -> tuple[lmpchain.Scene, float]:
    """Return a scene in which all beads move for this number of steps, and the step, s."""
    chain = lmpchain.Chain(grains=grains, diameter=1e-3)
    mass = chain.masses[0]
    deepest = chain.part(grains - 1, grains)
    speed = STRENGTH * chain.equilibrium_overlap * np.sqrt(chain.linear_stiffness / mass)
    random = np.random.default_rng(grains).uniform(-1, 1, grains - 1)
    strike = lmpchain.Profile(velocity=np.append(random * speed, 0.0))  # Grain N is fixed.
    step = PHASE * math.sqrt(mass / float(deepest.linear_stiffness[0]))
    return lmpchain.Scene(
        chain=chain, excitation=strike, duration=steps * step, samples=2, grains="1:2"
    ), step


def throughput(name: str, grains: int, share: float) -> Row:
    """Time the integration of a moving chain, for a fraction of the work of a full run."""
    engine = name.split()[0]
    scene, step = stirred(grains, max(8, int(share * min(WORK[engine] / grains, STEPS[engine]))))
    run = lmpchain.simulate(scene, ENGINES[name](step))
    cost = run.cost
    return {
        "engine": name,
        "grains": grains,
        "grain_steps_per_s": cost.force_evaluations * cost.active_grains / cost.integration_s,
        "active_grains": cost.active_grains,
        "steps": cost.steps,
        "force_evaluations": cost.force_evaluations,
        "integration_s": cost.integration_s,
        "setup_s": cost.setup_s,
        "provenance": run.provenance,
    }


def answer(grains: int) -> Row:
    """Time a whole call for a strike on grain 1, including the error estimate."""
    began = time.perf_counter()
    chain = lmpchain.Chain(grains=grains, material=lmpchain.GLASS, diameter=1e-3)
    strike = lmpchain.Impulse(velocity=8.57e-4)
    scene = lmpchain.Scene(
        chain=chain, excitation=strike, duration=100e-6, grains=f"1:{min(64, grains)}"
    )
    run = lmpchain.simulate(scene, "native")
    return {
        "grains": grains,
        "seconds": time.perf_counter() - began,
        "active_grains": run.cost.active_grains,
    }


def many(threads: int, steps: int, realisations: int) -> Row:
    """Time a whole ensemble of random chains of 120 grains."""
    chain = lmpchain.Chain(grains=120, diameter=1e-3)
    scene = lmpchain.Scene(
        chain=chain, excitation=lmpchain.Impulse(velocity=1e-6), duration=100e-6, samples=2
    )
    engine = Native(integrator="verlet", step=scene.duration / steps, threads=threads)
    began = time.perf_counter()
    ensemble(scene, 10, realisations, seed=1, engine=engine)
    seconds = time.perf_counter() - began
    return {"threads": threads, "steps": steps, "realisations": realisations, "seconds": seconds}


def best(rows: list[Row], keys: tuple[str, ...], cost: Callable[[Row], float]) -> list[Row]:
    """Return the cheapest of the rows with equal keys, in their original order."""
    groups: dict[tuple, list[Row]] = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in keys)].append(row)
    return [min(group, key=cost) for group in groups.values()]


def measure(quick: bool) -> dict[str, list[Row]]:
    """Measure everything, alternating between kinds so that a busy moment does not bias one."""
    largest = 4 if quick else 6
    sizes = [10**k for k in range(2, largest + 1)]
    share, runs, chains = (0.01, 1, 50) if quick else (1.0, RUNS, 1000)
    answer(100), many(1, 100, 2)  # These calls compile before the timing.
    speeds = []
    answers = []
    ensembles = []
    for _ in range(runs):
        for grains in sizes:
            for name in ENGINES:
                if name.startswith("native") or grains <= 10**5:
                    speeds.append(throughput(name, grains, share))
            answers.append(answer(grains))
        for steps in LENGTHS:
            ensembles += [many(threads, steps, chains) for threads in THREADS]
    return {
        "throughput": best(speeds, ("engine", "grains"), lambda row: -row["grain_steps_per_s"]),
        "answers": best(answers, ("grains",), lambda row: row["seconds"]),
        "ensembles": best(ensembles, ("threads", "steps"), lambda row: row["seconds"]),
    }


def tables(numbers: dict[str, list[Row]]) -> str:
    """Return the numbers as Markdown tables."""
    lines = [
        "| grains | " + " | ".join(ENGINES) + " | strike on grain 1 |",
        "|---" * (len(ENGINES) + 2) + "|",
    ]
    speeds = {
        (row["engine"], row["grains"]): row["grain_steps_per_s"] for row in numbers["throughput"]
    }
    for row in numbers["answers"]:
        values = [speeds.get((name, row["grains"])) for name in ENGINES]
        cells = [f"{value / 1e6:.4g} M/s" if value else "" for value in values]
        cells.append(f"{row['seconds'] * 1e3:.3g} ms, {row['active_grains']} computed")
        lines.append(f"| {row['grains']:,} | " + " | ".join(cells) + " |")
    lines += [
        "",
        "| chains of 120 grains | steps | "
        + " | ".join(f"threads: {t}" for t in THREADS)
        + " | gain |",
    ]
    lines.append("|---" * (len(THREADS) + 3) + "|")
    for steps in dict.fromkeys(row["steps"] for row in numbers["ensembles"]):
        rows = [row for row in numbers["ensembles"] if row["steps"] == steps]
        cells = [f"{row['seconds']:.3g} s" for row in rows]
        gain = rows[0]["seconds"] / rows[-1]["seconds"]
        lines.append(
            f"| {rows[0]['realisations']} | {steps} | " + " | ".join(cells) + f" | {gain:.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, print the tables, store the numbers and draw."""
    given = arguments(
        __file__, __doc__, draw="draw the stored numbers again, without a measurement"
    )
    stored = given.output.with_suffix(".json")
    if given.draw:
        numbers = json.loads(stored.read_text(encoding="utf-8"))
    else:
        numbers = {"machine": machine()} | measure(given.quick)
        with write_aside(stored, overwrite=True) as aside:
            aside.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    print(tables(numbers))
    finish(draw(numbers), given.output)


def draw(numbers: dict[str, Any]) -> Figure:
    """Draw the speed against the number of grains."""
    picture = figure(7, 4.2)
    speed = picture.subplots()
    for name in ENGINES:
        rows = [row for row in numbers["throughput"] if row["engine"] == name]
        speed.loglog(
            [row["grains"] for row in rows],
            [row["grain_steps_per_s"] for row in rows],
            label=name,
            **STYLES[name],
        )
    speed.set(xlabel="grains, all in motion", ylabel="grain-steps (1/s)", ylim=(3e6, 3e9))
    legends(picture, loc="center right")
    return picture


if __name__ == "__main__":
    main()
