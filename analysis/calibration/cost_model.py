"""Measure the timing constants of the cost model: of time stepping and of the linear engines.

Times depend on the machine: shipped numbers are those of one processor, and `lmpchain plan
--calibrate` measures a machine's own. What must hold is that engines which differ by ten are told
apart, so a constant is supported within a factor of three. Every run is timed some times and the
shortest counts. The coefficients of the linear engines are fitted to the logarithms of the times of
many scenes. They are not all told apart by times: each is drawn to its shipped value as if that
were known to a factor of ten, so only what the times demand moves it. On a busy machine run it with
OPENBLAS_NUM_THREADS=1: threads that wait for each other say nothing about modes.

    python analysis/calibration/cost_model.py           # a minute
    python analysis/calibration/cost_model.py --quick   # seconds
"""

from __future__ import annotations

import math
import warnings

import numpy as np
from common import Row, best, command, quantile
from scipy.optimize import least_squares, nnls

from lmpchain import Chain, Impulse, Law, Profile, Scene, engines
from lmpchain.engines.base import Engine
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.engine import LETTER_OVERHEAD, VISCOUS_OVERHEAD, Lammps
from lmpchain.engines.linear.closed_form import Bessel
from lmpchain.engines.linear.engine import Chebyshev, LinearEngine, Modes
from lmpchain.engines.linear.model_error import dense, evaluations
from lmpchain.engines.native import Native
from lmpchain.engines.stepping.time_stepping import EVALUATION_OVERHEAD
from lmpchain.integrators.kernels.chebyshev import SPAN, terms
from lmpchain.simulation.api import simulate

FACTOR = 3.0  # Factor between machines, and between a time and its estimate.
PARTS = {  # Names of the literals of `work` in their order.
    "modes": ("5.5e-11 N^3", "6e-8 N a look"),
    "chebyshev": ("7e-10 (N + 100) a polynomial", "1.3e-8 N a look"),
}


def shaken(grains: int, periods: float, samples: int = 11) -> Scene:
    """Return a loaded chain whose grains all move gently."""
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    velocity = 1e-3 * chain.length_scale / chain.time_scale * np.sin(np.arange(grains))
    velocity[chain.movable :] = 0.0
    return Scene(
        chain=chain,
        excitation=Profile(velocity=velocity),
        duration=periods * chain.time_scale,
        samples=samples,
    )


def struck(grains: int, periods: float, samples: int) -> Scene:
    """Return a loaded chain with a gentle strike on top, with all grains recorded."""
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    return Scene(
        chain=chain,
        excitation=Impulse(velocity=1e-12),
        duration=periods * chain.time_scale,
        samples=samples,
    )


def supported(name: str, shipped: float, measured: float, says: str) -> Row:
    """Return the row of a time that is supported within a factor of three."""
    return Row(name, shipped, measured, measured / FACTOR, measured * FACTOR, says)


def _stepping(
    engine: Engine, sizes: tuple[int, ...], most: float, repeats: int
) -> tuple[float, float]:
    """Return seconds per grain and evaluation with auxiliary runs, and the overhead in grains."""
    features = []
    times = []
    for grains in sizes:
        for periods in (2.0, most / grains + 2.0):
            scene = shaken(grains, periods)
            candidate = engine.propose(scene, 1e-4)
            spent = []
            for _ in range(repeats):
                run = engine.start([scene], candidate)
                for _ in run.blocks():
                    pass
                cost = run.cost()
                run.close()
                spent.append(cost.integration_s + cost.estimate_s)
            features.append((cost.force_evaluations * grains, cost.force_evaluations, 1.0))
            times.append(min(spent))
    scaled = np.array(features) / np.array(times)[:, None]
    size = scaled.max(0)
    per_grain, per_call, _ = nnls(scaled / size, np.ones(len(times)))[0] / size
    return float(per_grain), float(per_call / max(per_grain, 1e-300))


def _fitted(features: np.ndarray, times: np.ndarray, shipped: np.ndarray) -> np.ndarray:
    """Return coefficients that reproduce the times within some 30 %, near the shipped ones."""

    def off(logs: np.ndarray) -> np.ndarray:
        told = features @ (shipped * np.exp(logs))
        return np.append(np.log(told / times) / 0.3, logs / math.log(10))

    return shipped * np.exp(least_squares(off, np.zeros(shipped.size), loss="soft_l1").x)


def _features(name: str, scene: Scene) -> tuple[float, ...]:
    """Return the terms that the numerical coefficients of `work` multiply."""
    grains = scene.chain.grains
    looks = scene.samples + (0 if dense(scene) else evaluations(scene))
    if name == "modes":
        return grains**3, grains * looks
    radians = scene.chain.band_edge * scene.duration
    series = min(looks, max(1.0, radians / SPAN))
    polynomials = series * terms(radians / series)
    reached = min(grains, 30 + radians / 4)
    return polynomials * (reached + 100), looks * grains


def _linear(engine: LinearEngine, quick: bool) -> list[Row]:
    """Return the rows of the literals of `work`, and of the accuracy of the shipped ones."""
    rng = np.random.default_rng(81)
    features = []
    times = []
    told = []
    most = 600 if engine.name == "modes" and not quick else 200 if engine.name == "modes" else 3000
    for _ in range(25 if quick else 120):
        grains = int(10 ** rng.uniform(0.5, math.log10(most)))
        periods = 10 ** rng.uniform(0.5, 3)
        samples = int(10 ** rng.uniform(0.5, 3))
        scene = struck(grains, periods, samples)

        def run(scene: Scene = scene) -> None:
            running = engine.start([scene], engine.propose(scene, 1.0))
            for _ in running.blocks():
                pass

        features.append(_features(engine.name, scene))
        times.append(best(run, 3))
        told.append(engine.work(scene))
    table = np.array(features, dtype=float)
    measured = np.array(times)
    scaled = table / np.array(told)[:, None]
    own = np.linalg.lstsq(scaled / scaled.max(0), np.ones(len(told)), rcond=None)[0] / scaled.max(0)
    here = _fitted(table, np.maximum(measured - engine.start_up_s / 2, 1e-5), own)
    ratios = measured / (np.array(told) + engine.start_up_s)
    low, middle, high = (quantile(ratios, part) for part in (0.1, 0.5, 0.9))
    says = (
        f"time over start_up_s and work of {len(times)} scenes: median; 10 to 90 % {low:.2g} to "
        f"{high:.2g}"
    )
    rows = [supported(f"{engine.name}.work", 1.0, middle, says)]
    each = np.array([table[:, k] * own[k] / np.array(told) for k in range(own.size)])
    for k, part in enumerate(PARTS[engine.name]):
        share = float(np.max(each[k]))
        rows.append(
            supported(
                f"{engine.name}.work: {part}",
                own[k],
                here[k],
                f"s; at most {100 * share:.0f} % of the work of a scene",
            )
        )
    return rows


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    repeats = 3 if quick else 7
    rows = []
    for engine, sizes, most in (
        (
            Native(),
            (10, 30, 100, 300, 1000) if quick else (5, 10, 20, 50, 100, 200, 500, 1000, 3000),
            1e5,
        ),
        (Lammps(), (10, 100) if quick else (10, 30, 100, 300, 1000), 5e3),
    ):
        per_grain, call = _stepping(engine, sizes, most / 5 if quick else most, repeats)
        name = f"{engine.name}.seconds_per_grain_step"
        rows.append(
            supported(
                name,
                engine.seconds_per_grain_step,
                per_grain,
                "s a grain and force evaluation, companions included",
            )
        )
        rows.append(
            supported(
                f"EVALUATION_OVERHEAD ({engine.name})",
                EVALUATION_OVERHEAD,
                call,
                "grains that take as long as the rest of an evaluation",
            )
        )
    with warnings.catch_warnings(action="ignore"):
        for name in (*engines.names(),):
            scene = struck(2, 1.0, 3)
            if name == "continuum":
                scene = Scene(
                    chain=Chain(grains=2, diameter=1e-3),
                    excitation=Impulse(velocity=1e-12),
                    duration=1e-6,
                    samples=3,
                )
            simulate(scene, name, 0.5, on_miss="warn")
            took = best(
                lambda name=name, scene=scene: simulate(scene, name, 0.5, on_miss="warn"), repeats
            )  # type: ignore[misc]
            rows.append(
                supported(
                    f"{name}.start_up_s",
                    engines.get(name).start_up_s,
                    took,
                    "s, the smallest answer",
                )
            )
    for engine in (Modes(), Chebyshev()):
        rows += _linear(engine, quick)
    return [*rows, *_laws_by_formula(100 if quick else 400), _closed_form(quick)]


def _laws_by_formula(steps: int) -> list[Row]:
    """Return the rows of LAMMPS with contact laws by formula, without and with viscosity."""
    law = Law("k*max(o, 0)**1.5*(1 + c*o)", c=1e3)
    engine = Lammps("verlet", 1e-5 / steps)

    def scene_of(chain: Chain) -> Scene:
        # All grains move, so that none is left out.
        velocity = 1e-4 * np.sin(np.arange(chain.grains))
        velocity[chain.movable :] = 0.0
        return Scene(chain=chain, excitation=Profile(velocity=velocity), duration=1e-5, samples=3)

    def evaluation(chain: Chain) -> float:
        costs = [simulate(scene_of(chain), engine).cost for _ in range(3)]
        return min(cost.integration_s / cost.force_evaluations for cost in costs)

    diameters = 1e-3 * np.linspace(1.0, 1.2, 20)
    chains = [Chain(grains=20, diameter=diameter, law=law) for diameter in (1e-3, diameters)]
    letters = [LammpsColumn(scene_of(chain), 0.0).parsed_letters for chain in chains]
    alike, different = map(evaluation, chains)
    letter = (different - alike) / (letters[1] - letters[0])
    long = Chain(grains=1000, diameter=1e-3, gravity=0.0, top_load=1.0, law=law)
    viscous = evaluation(long.replace(damping={"viscoelastic": 1e-9})) - evaluation(long)
    unit = engine.seconds_per_grain_step
    return [
        supported("LETTER_OVERHEAD", LETTER_OVERHEAD, letter / unit, "grains a letter"),
        supported("VISCOUS_OVERHEAD", VISCOUS_OVERHEAD, viscous / 1000 / unit, "grains a grain"),
    ]


def _closed_form(quick: bool) -> Row:
    """Return the row of the closed forms: seconds per value."""
    engine = Bessel()
    scene = struck(300, 50.0, 31 if quick else 101)
    shipped = (engine.work(scene) - Chebyshev().work(scene)) / (scene.samples * scene.chain.grains)
    took = best(lambda: engine.wave(scene, scene.time), 3) / (scene.samples * scene.chain.grains)
    return supported(
        "ClosedForm.work: 1e-6 a value", shipped, took, "s a value of the engine bessel"
    )


if __name__ == "__main__":
    command(main, __doc__)
