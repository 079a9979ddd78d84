"""CPU time of the engine that "auto" chooses, relative to the fastest suitable engine.

Random weak scenes: 2 to 2000 grains, 1 to 10^4 radians, 2 to 1000 samples, exponents from 1.1 to 3,
tolerances from 1e-3 to 1e-9, and strikes so weak that linear theory is expected to be within the
tolerance. Processor times of whole answers, the shortest of some.

    python analysis/auto_choice.py             # some minutes
    python analysis/auto_choice.py --scenes 20
"""

import argparse
import json
import math
import os
import time
import warnings

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

import lmpchain
from lmpchain import Chain, Impulse, InputError, Profile, Scene, engines
from lmpchain.engines.linear.model_error import expected_error

ENGINES = ("native", "modes", "chebyshev")
REPEATS = 5
ENOUGH_S = 0.1  # Longer solutions are timed twice.


def draw(rng: np.random.Generator) -> tuple[Scene, float]:
    """Return a random scene and a tolerance."""
    grains = int(10 ** rng.uniform(math.log10(2), math.log10(2000)))
    heavy = rng.random() < 0.5
    loaded = not heavy or rng.random() < 0.5
    diameter = 10 ** rng.uniform(-3.5, -2)
    chain = Chain(
        grains=grains,
        diameter=diameter if rng.random() < 0.6 else diameter * rng.uniform(0.8, 1.2, grains),
        gravity=9.81 if heavy else 0.0,
        top_load=10 ** rng.uniform(-2, 1) if loaded else 0.0,
        exponent=rng.uniform(1.1, 3.0),
    )
    velocity = np.zeros(grains)
    velocity[: chain.movable] = 1e-12 * rng.normal(size=chain.movable)
    grain = int(rng.choice([1, rng.integers(1, chain.movable + 1)]))
    impulse = Impulse(velocity=1e-12, grain=grain)
    scene = Scene(
        chain=chain,
        excitation=impulse if rng.random() < 0.8 else Profile(velocity=velocity),
        duration=10 ** rng.uniform(0, 4) / chain.band_edge,
        samples=int(10 ** rng.uniform(math.log10(2), 3)),
    )
    tolerance = 10 ** rng.uniform(-9, -3)
    strength = tolerance * 10 ** rng.uniform(-3, 0) / expected_error(scene)
    return scene.replace(excitation=scene.excitation.scaled(strength)), tolerance


def measure(scene: Scene, tolerance: float) -> dict[str, float]:
    """Return the shortest time of each engine, s; a missed tolerance adds a native run."""
    shortest = dict.fromkeys(ENGINES, math.inf)
    for repeat in range(REPEATS):
        for name in ENGINES:
            if repeat > 1 and shortest[name] > ENOUGH_S:
                continue
            fresh = Scene(**scene.given())
            began = time.process_time()
            lmpchain.simulate(fresh, name, tolerance, on_miss="warn")
            shortest[name] = min(shortest[name], time.process_time() - began)
    modes = engines.Modes()
    if modes.look(modes.part(scene)).at_most > tolerance:
        for name in ("modes", "chebyshev"):
            shortest[name] += shortest["native"]
    return shortest


def main() -> None:
    """Print the fraction of scenes in which the choice takes at most 1.5 times as long."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", help="file for what was measured")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(arguments.seed)
    rows = []
    while len(rows) < arguments.scenes:
        try:
            scene, tolerance = draw(rng)
        except InputError:  # The contacts are pressed too much by the weight.
            continue
        if not rows:
            measure(scene, tolerance)  # This call compiles.
        took = measure(scene, tolerance)
        plan = lmpchain.plan(scene, tolerance)
        rows.append(
            {
                "grains": scene.chain.grains,
                "active": scene.reached.chain.grains,
                "phase": scene.duration * scene.highest_frequency,
                "samples": scene.samples,
                "tolerance": tolerance,
                "engine": plan.engine,
                "took": took,
                "costs": {row.engine: row.cost_s for row in plan.candidates},
                "ratio": took[plan.engine] / min(took.values()),
            }
        )
    if arguments.rows:
        with open(arguments.rows, "w", encoding="utf-8") as file:
            json.dump(rows, file)
    ratios = np.array([row["ratio"] for row in rows])
    chosen = {name: sum(row["engine"] == name for row in rows) for name in ENGINES}
    print(f"{len(rows)} scenes, chosen: {chosen}")
    print(f"at most 1.5 times the fastest: {100 * np.mean(ratios <= 1.5):.1f} %")
    print(f"worst: {', '.join(f'{ratio:.1f}' for ratio in np.sort(ratios)[-10:])}")


if __name__ == "__main__":
    main()
