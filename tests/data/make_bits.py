"""Hash the answers to 200 random scenes by every engine, integrator and end: `bits.json` beside this file.

    python tests/data/make_bits.py [FIRST LAST]      writes bits.json, or prints what those scenes give

Answers rest on the last bit of NumPy, SciPy and the compiler for one kind of processor, so the table names these, and
`tests/simulation/test_bits.py` compares bits where they are the same.
"""

import hashlib
import json
import platform
import sys
import tempfile
import warnings
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from helpers.example_scenes import random_scene

import lmpchain
from lmpchain import InputError, RunFailed, ToleranceNotMet

TABLE = Path(__file__).with_name("bits.json")
SCENES = 200
NATIVE = ("auto", "verlet", "rkn4", "rkn6", "kahan-li6", "kahan-li8", "dop853", "gear4")
LAMMPS = ("rkn6", "kahan-li6", "verlet")
LINEAR = ("modes", "chebyshev", "bessel", "continuum")
FAILURES = (InputError, RunFailed, ToleranceNotMet)


def fingerprint() -> dict[str, str]:
    """Return what the last bit of an answer rests on besides this package."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    flags = next(line for line in lines if line.startswith("flags"))
    vector = sorted(set(flags.split()) & {"fma", "avx2", "avx512f"})
    packages = {name: version(name) for name in ("numpy", "scipy", "numba", "llvmlite", "lammps")}
    return packages | {"machine": platform.machine(), "vector": " ".join(vector)}


def digest(*arrays: np.ndarray) -> str:
    """Return a short hash of arrays."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()[:16]


def answer(scene, engine, tolerance, folder=None, **options) -> list:
    """Return the hash of an answer, its error estimate and its steps; or what was raised."""
    with warnings.catch_warnings(action="ignore"):
        try:
            if folder is None:
                t = lmpchain.simulate(scene, engine, tolerance, on_miss="warn", **options)
            else:
                try:
                    t = lmpchain.simulate(
                        scene, engine, tolerance, on_miss="warn", folder=folder, max_wall=1e-9, **options
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


def cases(number: int):
    """Yield the name and the answer of every case of one scene."""
    rng = np.random.default_rng([20261122, number])
    scene = random_scene(rng)
    tolerance = float(rng.choice([1e-3, 1e-4, 1e-6, 1e-8]))
    loose = max(tolerance, 1e-4)
    yield "scene", [hashlib.sha256(repr(sorted(scene.initial()[1])).encode()).hexdigest()[:16], scene.chain.grains]
    yield "auto", answer(scene, "auto", tolerance)
    for integrator in NATIVE:
        low = integrator in ("verlet", "gear4")
        yield f"native {integrator}", answer(scene, "native", loose if low else tolerance, integrator=integrator)
    step = 0.1 / scene.highest_frequency
    for integrator in NATIVE[1:]:
        yield f"native {integrator} step", answer(scene, "native", 1e-6, integrator=integrator, step=step)
    for name in LINEAR:
        yield name, answer(scene, name, tolerance)
    for integrator in LAMMPS:
        for diameter in ("physical", "gauge", "auto") if number % 4 == 0 else ("auto",):
            case = f"lammps {integrator} {diameter}"
            yield case, answer(scene, "lammps", 1e-3, integrator=integrator, diameter=diameter)
        yield f"lammps {integrator} step", answer(scene, "lammps", 1e-6, integrator=integrator, step=step)
    if number % 5 == 0:
        with tempfile.TemporaryDirectory() as scratch:
            for name in ("auto", "native", "modes", "chebyshev", "lammps"):
                yield f"{name} resumed", answer(scene, name, max(tolerance, 1e-6), Path(scratch) / name)
    if number % 10 == 0:
        try:
            plan = lmpchain.plan(scene, tolerance)
            yield (
                "plan",
                [
                    plan.engine,
                    plan.integrator,
                    plan.active_grains,
                    repr(float(plan.step)),
                    repr(float(plan.expected_error)),
                ],
            )
        except FAILURES as error:
            yield "plan", [type(error).__name__]


def batches():
    """Yield the name and the answer of ensembles of random chains and of sweeps, which go in batches."""
    from lmpchain import Chain, Impulse, Scene

    chain = Chain(grains=40, diameter=1e-3)
    for velocity in (1e-6, 8.57e-4):
        scene = Scene(chain=chain, excitation=Impulse(velocity=velocity), duration=4e-5, samples=5)
        for engine in ("chebyshev", "modes", "native"):
            e = lmpchain.disorder.ensemble(scene, 2, 40, 7, engine)
            errors = [repr(float(e.model_error)), repr(float(e.solver_error))]
            yield f"ensemble {velocity} {engine}", [digest(e.velocity, e.displacement_error), *errors]
        for engine in ("native", "chebyshev", "auto"):
            axes = [{"excitation.velocity": [velocity, 2 * velocity, 30 * velocity], "chain.gravity": [1.0, 10.0]}]
            source = {"scene": scene, "engine": engine, "tolerance": 1e-7, "keep": ["velocity"], "grid": axes[0]}
            with tempfile.TemporaryDirectory() as scratch:
                data = lmpchain.sweep(source, scratch)
                values = [data[key].to_numpy() for key in ("velocity", "solver_error", "model_error")]
            yield f"sweep {velocity} {engine}", [digest(*values)]


def main() -> None:
    """Make the table."""
    if len(sys.argv) == 3:
        for number in range(int(sys.argv[1]), int(sys.argv[2])):
            for name, found in cases(number):
                print(number, name, *found)
        return
    table = {str(number): dict(cases(number)) for number in range(SCENES)} | {"batches": dict(batches())}
    rows = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in table.items())
    TABLE.write_text(f'{{"made with": {json.dumps(fingerprint())},\n{rows}}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
