"""Cost of a damped run, relative to the same chain without damping at the same tolerance.

A column of 120 beads is struck at the top, by strike numbers from weak waves to contacts that open,
with A omega from hardly any damping to contacts that are dashpots; omega is the highest frequency
of the wave without damping, which turns by RADIANS. Times are seconds of the processor of whole
calls of the native engine with their estimate, taken in turns, of which the least counts.
"""

import argparse
import time

import lmpchain
from lmpchain import Scene

STRIKES = (0.01, 0.1, 1.0, 10.0, 100.0)
VISCOUS = (1e-3, 1e-2, 0.1, 1.0)  # Values of A omega.
TOLERANCES = (1e-3, 1e-6, 1e-9)
RADIANS = 200.0
REPEATS = 7


def lossless(strike: float) -> Scene:
    """Return the undamped scene of this strike number."""
    chain = lmpchain.Chain(grains=120, diameter=1e-3)
    one = Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1.0), duration=1e-4)
    # The strike number is the speed over the velocity scale of the contact at rest.
    speed = strike / one.strike_number
    scene = one.replace(excitation=lmpchain.Impulse(velocity=speed))
    return scene.replace(duration=RADIANS / scene.highest_frequency, samples=101)


def damped(scene: Scene, viscous: float) -> Scene:
    """Return the scene with viscous contacts of this A omega."""
    damping = lmpchain.Damping(viscoelastic=viscous / scene.highest_frequency)
    return scene.replace(chain=scene.chain.replace(damping=damping))


def take(scene: Scene, tolerance: float) -> tuple[float, int]:
    """Return the time, s, and the number of steps of one call."""
    began = time.process_time()
    answer = lmpchain.simulate(scene, "native", tolerance)
    return time.process_time() - began, answer.cost.steps


def compare(scene: Scene, tolerance: float) -> list[tuple[float, int]]:
    """Return the least time, s, and steps, without damping and with each A omega."""
    scenes = [scene, *(damped(scene, viscous) for viscous in VISCOUS)]
    taken = [[take(each, tolerance) for each in scenes] for _ in range(REPEATS)]
    return [min(of_one) for of_one in zip(*taken, strict=True)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", action="store_true", help="print steps, too")
    steps = parser.parse_args().steps
    head = " | ".join(f"Aω = {viscous:g}" for viscous in VISCOUS)
    print(f"| strike number | tolerance | without, ms | {head} |")
    print("|---|---|---|" + "---|" * len(VISCOUS))
    for strike in STRIKES:
        scene = lossless(strike)
        for tolerance in TOLERANCES:
            (bare, count), *others = compare(scene, tolerance)
            cells = [f"{spent / bare:.1f}" for spent, _ in others]
            if steps:
                cells = [f"{c} ({n / count:.1f})" for c, (_, n) in zip(cells, others, strict=True)]
            print(
                f"| {strike:g} | {tolerance:g} | {bare * 1e3:.2f} | {' | '.join(cells)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
