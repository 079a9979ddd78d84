"""Grain-steps per second of velocity Verlet in native, LAMMPS (several settings) and LIGGGHTS.

All contacts stay shut. The first line is how many square roots a second this machine takes, which
bounds the native engine with the plain force: one root a grain and step.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from time import perf_counter

import dem
import numba
import numpy as np
from problem import Problem
from with_lammps import LMP, deck, granular

import lmpchain
from lmpchain.benchmark.curves import machine
from lmpchain.engines import Native

GRAINS = 120, 1000, 10_000
# Velocities over eps_1 omega_1: contacts stay closed, and the motion is weak enough for the
# polynomial force.
SPEED = 0.05
FAINT = 1e-9
STEP = 0.02  # Relative to the time scale.
# Grain-steps of a run. Runs are short, because other processes disturb long ones.
NATIVE_WORK = 2e7
DEM_WORK = 1e6
NATIVE_RUNS = 40
DEM_RUNS = 7
ROOTS, REPEATS = 1024, 10_000  # Numbers that fit into the L1 cache, and number of passes over them.
TUNED = "atom_modify map array sort 0 0\nneighbor 1e-4 bin\nneigh_modify once yes"


@numba.njit(error_model="numpy", fastmath={"nnan", "ninf", "nsz"})
def _roots(values, times):
    for _ in range(times):
        for n in range(values.size):
            values[n] = np.sqrt(values[n])


def roots_per_second() -> float:
    """Return the peak rate of double square roots on one core, vectorised, from the L1 cache."""
    values = np.full(ROOTS, 2.0)
    _roots(values, 1)

    def once() -> float:
        begin = perf_counter()
        _roots(values, REPEATS)
        return perf_counter() - begin

    return ROOTS * REPEATS / min(once() for _ in range(NATIVE_RUNS))


def everywhere(grains: int, work: float, speed: float) -> lmpchain.Scene:
    """Return a scene of `work` grain-steps in which every grain moves from the start."""
    chain = lmpchain.Chain(grains=grains, material="glass", diameter=1e-3)
    velocity = (
        np.random.default_rng(1).uniform(-1, 1, grains)
        * speed
        * chain.length_scale
        / chain.time_scale
    )
    velocity[-1] = 0.0
    duration = round(work / grains) * STEP * chain.time_scale
    return lmpchain.Scene(
        chain=chain, excitation=lmpchain.Profile(velocity=velocity), duration=duration, samples=2
    )


def native(grains: int, force: str, speed: float) -> tuple[float, str]:
    """Return grain-steps per second, and the form of the force."""
    scene = everywhere(grains, NATIVE_WORK, speed)
    step = STEP * scene.chain.time_scale * (1 + 1e-9)
    runs = [
        lmpchain.simulate(scene, Native("verlet", step=step, force=force))
        for _ in range(NATIVE_RUNS)
    ]
    seconds = min(run.cost.integration_s for run in runs)
    return runs[0].cost.force_evaluations * grains / seconds, runs[0].provenance["force"]


def discrete(
    grains: int, command: list[str], text: Callable[[Problem], str]
) -> tuple[float, np.ndarray]:
    """Return grain-steps per second, and the final displacements."""
    problem = Problem(everywhere(grains, DEM_WORK, SPEED))
    step = STEP * problem.time
    answers = [dem.solve(command, text(problem), problem, step) for _ in range(DEM_RUNS)]
    return answers[0].force_evaluations * grains / min(a.seconds for a in answers), answers[
        0
    ].displacement


def _hertz_history(problem: Problem) -> str:
    chain = problem.scene.chain
    constant = float(chain.contact_constants[0] / np.sqrt(chain.diameters[0] / 4))
    return f"pair_style gran/hertz/history {constant!r} 0.0 0.0 0.0 0.0 0\npair_coeff * *"


def ways() -> dict[str, tuple[list[str], Callable[[Problem], str]]]:
    """Return the programs with the functions that make their decks."""
    programs = {}
    for name, pair in (("granular", granular), ("gran/hertz/history", _hertz_history)):
        programs[f"LAMMPS {name}"] = [LMP], lambda p, pair=pair: deck(pair(p))
        for newton in ("off", "on"):
            programs[f"LAMMPS {name}, tuned, newton {newton}"] = (
                [LMP],
                (lambda p, pair=pair, newton=newton: deck(pair(p), TUNED, newton, "nve")),
            )
    try:
        liggghts = import_module("with_liggghts")
    except ImportError as missing:
        print(f"left out: {missing}")
    else:
        programs["LIGGGHTS hertz"] = [liggghts.LIGGGHTS], liggghts.deck
    return programs


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grains", type=int, nargs="+", default=GRAINS)
    given = parser.parse_args()
    limit = roots_per_second()
    print(f"{machine()}: {limit:.3g} square roots a second\n")
    print(
        "| grains | code | grain-steps a second | native, plain / it | same bytes as users' LAMMPS "
        "|\n" + "|---" * 5 + "|"
    )
    for grains in given.grains:
        plain, form = native(grains, "plain", SPEED)
        print(
            f"| {grains} | native, {form} ({plain / limit:.0%} of the square roots) | {plain:.3g} "
            "| 1 | |"
        )
        for force, speed in (("exact", SPEED), ("auto", FAINT)):
            rate, form = native(grains, force, speed)
            print(f"| {grains} | native, {form} | {rate:.3g} | {plain / rate:.2f} | |")
        usual = None
        for name, (command, text) in ways().items():
            rate, displacement = discrete(grains, command, text)
            usual = displacement if usual is None else usual
            same = "yes" if np.array_equal(displacement, usual) else "no"
            print(f"| {grains} | {name} | {rate:.3g} | {plain / rate:.3g} | {same} |", flush=True)


if __name__ == "__main__":
    main()
