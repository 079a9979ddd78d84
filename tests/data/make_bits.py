"""Hash the results of 200 random scenes for every engine, integrator and end, as `bits.json`.

    python tests/data/make_bits.py                         # makes the table anew
    python tests/data/make_bits.py --check [EVERY]   # prints what differs; of every 10th scene, say

The last bits of an answer also depend on the versions of NumPy, SciPy and the compiler, on the
processor, and on variables of the environment that choose instructions of another processor. The
table names these; if they differ, `--check` and the tests, `test_bits.py` in `tests/engines/` and
`tests/simulation/`, compare engines, steps and error estimates instead of bits.
"""

import argparse
import hashlib
import json
import math
import os
import platform
import re
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from helpers.example_scenes import random_scene
from llvmlite.binding import get_host_cpu_name

import lmpchain
from lmpchain import Chain, Impulse, InputError, RunFailed, Scene, ToleranceNotMet

TABLE = Path(__file__).with_name("bits.json")
SCENES = 200
NATIVE = ("auto", "verlet", "rkn4", "rkn6", "kahan-li6", "kahan-li8", "dop853", "gear4")
LAMMPS = ("rkn6", "kahan-li6", "verlet")
LINEAR = ("modes", "chebyshev", "bessel", "continuum")
FAILURES = (InputError, RunFailed, ToleranceNotMet)
Row = list[Any]  # Hashes, numbers and names.
HASH = re.compile("[0-9a-f]{16}")
ROUND_OFF = 1e-12  # Error estimates below this value are random.
# Variables that make numba, NumPy and OpenBLAS use instructions of another processor.
INSTRUCTIONS = (
    "NUMBA_CPU_NAME",
    "NUMBA_CPU_FEATURES",
    "NPY_DISABLE_CPU_FEATURES",
    "NPY_ENABLE_CPU_FEATURES",
    "OPENBLAS_CORETYPE",
)


def fingerprint() -> dict[str, str]:
    """Return the versions and the processor that determine the last bit of a result."""
    packages = {name: version(name) for name in ("numpy", "scipy", "numba", "llvmlite", "lammps")}
    return packages | {
        "machine": platform.machine(),
        "processor": get_host_cpu_name(),
        "instructions": " ".join(f"{k}={os.environ[k]}" for k in INSTRUCTIONS if k in os.environ),
    }


def digest(*arrays: np.ndarray) -> str:
    """Return a short hash of arrays."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()[
        :16
    ]


def answer(
    scene: Scene, engine: str, tolerance: float, folder: Path | None = None, **options: Any
) -> Row:
    """Return the hash of a trajectory, its errors, engine and steps, or the name of an exception.

    With a folder the run is stopped after its first samples and resumed.
    """
    options |= {"on_miss": "warn"}
    with warnings.catch_warnings(action="ignore"):
        try:
            if folder is None:
                t = lmpchain.simulate(scene, engine, tolerance, **options)
            else:
                try:
                    t = lmpchain.simulate(
                        scene, engine, tolerance, folder=folder, max_wall=1e-9, **options
                    )
                except lmpchain.Stopped:
                    t = lmpchain.resume(folder)
        except FAILURES as error:
            return [type(error).__name__]
    e = t.error_estimate
    return [
        digest(t.displacement[:], t.velocity[:]),
        repr(float(e.model)),
        repr(float(e.solver)),
        t.engine,
        t.cost.steps,
    ]


def drawn(number: int) -> tuple[Scene, float]:
    """Return one of the scenes and its tolerance."""
    rng = np.random.default_rng([20261122, number])
    return random_scene(rng), float(rng.choice([1e-3, 1e-4, 1e-6, 1e-8]))


def engine_cases(number: int) -> Iterator[tuple[str, Row]]:
    """Yield the name of every case of a named engine, and its result for one scene."""
    scene, tolerance = drawn(number)
    loose = max(tolerance, 1e-4)
    velocities = repr(sorted(scene.initial()[1])).encode()
    yield "scene", [hashlib.sha256(velocities).hexdigest()[:16], scene.chain.grains]
    for integrator in NATIVE:
        low = integrator in ("verlet", "gear4")
        yield (
            f"native {integrator}",
            answer(scene, "native", loose if low else tolerance, integrator=integrator),
        )
    step = 0.1 / scene.highest_frequency
    for integrator in NATIVE[1:]:
        yield (
            f"native {integrator} step",
            answer(scene, "native", 1e-6, integrator=integrator, step=step),
        )
    for name in LINEAR:
        yield name, answer(scene, name, tolerance)
    for integrator in LAMMPS:
        for diameter in ("physical", "gauge", "auto") if number % 4 == 0 else ("auto",):
            case = f"lammps {integrator} {diameter}"
            yield case, answer(scene, "lammps", 1e-3, integrator=integrator, diameter=diameter)
        yield (
            f"lammps {integrator} step",
            answer(scene, "lammps", 1e-6, integrator=integrator, step=step),
        )


def choice_cases(number: int) -> Iterator[tuple[str, Row]]:
    """Yield the cases of one scene with engine choice or with a resumed run."""
    scene, tolerance = drawn(number)
    yield "auto", answer(scene, "auto", tolerance)
    if number % 5 == 0:
        with tempfile.TemporaryDirectory() as scratch:
            for name in ("auto", "native", "modes", "chebyshev", "lammps"):
                yield (
                    f"{name} resumed",
                    answer(scene, name, max(tolerance, 1e-6), Path(scratch) / name),
                )
    if number % 10 == 0:
        yield "plan", planned(scene, tolerance)


def cases(number: int) -> Iterator[tuple[str, Row]]:
    """Yield the name and the result of every case of one scene."""
    yield from engine_cases(number)
    yield from choice_cases(number)


def planned(scene: Scene, tolerance: float) -> Row:
    """Return the contents of a plan, or the name of the exception."""
    try:
        plan = lmpchain.plan(scene, tolerance)
    except FAILURES as error:
        return [type(error).__name__]
    step = repr(float(plan.step))
    error = repr(float(plan.expected_error))
    return [plan.engine, plan.integrator, plan.active_grains, step, error]


def batches() -> Iterator[tuple[str, Row]]:
    """Yield the name and result of ensembles and sweeps, which are run in batches."""
    column = Chain(grains=40, diameter=1e-3)
    for velocity in (1e-6, 8.57e-4):
        scene = Scene(chain=column, excitation=Impulse(velocity=velocity), duration=4e-5, samples=5)
        for engine in ("chebyshev", "modes", "native"):
            e = lmpchain.disorder.ensemble(scene, 2, 40, 7, engine)
            errors = [repr(float(e.model_error)), repr(float(e.solver_error))]
            yield (
                f"ensemble {velocity} {engine}",
                [digest(e.velocity, e.displacement_error), *errors],
            )
        grid = {
            "excitation.velocity": [velocity, 2 * velocity, 30 * velocity],
            "chain.gravity": [1.0, 10.0],
        }
        for engine in ("native", "chebyshev", "auto"):
            asked = {
                "scene": scene,
                "engine": engine,
                "tolerance": 1e-7,
                "keep": ["velocity"],
                "grid": grid,
            }
            with tempfile.TemporaryDirectory() as scratch:
                data = lmpchain.sweep(asked, scratch)
                values = [
                    data[key].to_numpy() for key in ("velocity", "solver_error", "model_error")
                ]
            yield f"sweep {velocity} {engine}", [digest(*values)]


def alike(one: Row, other: Row) -> bool:
    """Return whether two rows differ only in bits: equal engine and failure, numbers within 1e-3.

    Estimates of LAMMPS agree to a tenth: a part of them is its round-off as measured, which is
    chance. Steps agree to 2 %: last digits decide which steps of an adaptive method are refused,
    up to 1.7 % of them on two processors.
    """

    def close(a: Any, b: Any) -> bool:
        if HASH.fullmatch(str(a)) and HASH.fullmatch(str(b)):
            return True
        within = 0.02 if isinstance(a, int) else 0.1 if "lammps" in one else 1e-3
        try:
            return math.isclose(float(a), float(b), rel_tol=within, abs_tol=ROUND_OFF)
        except ValueError:
            return bool(a == b)

    return len(one) == len(other) and all(map(close, one, other))


def differences(key: str, found: Iterable[tuple[str, Row]], some: bool = False) -> Iterator[str]:
    """Yield a line for every case of a scene, or of the batches, that differs from the table.

    `some` says that these are not all of its cases.
    """
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    left = table[key]
    bits = table["made with"] == fingerprint()
    for name, row in found:
        stored = left.pop(name, [])
        if row != stored and (bits or not alike(row, stored)):
            yield f"{key}, {name}: {row}, stored {stored}"
    if not some:
        yield from (f"{key}, {name}: not found, stored {stored}" for name, stored in left.items())


def main() -> None:
    """Make the table, or print the differences from it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", nargs="?", type=int, const=1, metavar="EVERY")
    every = parser.parse_args().check
    if every:
        scenes = (differences(str(number), cases(number)) for number in range(0, SCENES, every))
        found = list(chain.from_iterable([*scenes, differences("batches", batches())]))
        print(*found, f"{len(found)} cases differ", sep="\n")
        sys.exit(bool(found))
    table = {str(number): dict(cases(number)) for number in range(SCENES)} | {
        "batches": dict(batches())
    }
    rows = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in table.items())
    TABLE.write_text(f'{{"made with": {json.dumps(fingerprint())},\n{rows}}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
