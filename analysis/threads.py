"""Speed-up of one long chain by several threads, with the same bits.

All grains move: gently, at steps of one length, and so that contacts open all over the chain and
steps shorten. Times are those of the integration alone, interleaved; the least of several runs
counts. More threads than free cores gain nothing.
"""

import argparse
import os
import time

import numpy as np
from numpy.typing import NDArray
from scaling import stirred

import lmpchain
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

REACH = 0.3  # Value of omega h.
MORE = 12  # Number of adaptive steps for each step of that length.


def shaken(grains: int, steps: int) -> lmpchain.Scene:
    """Return a loaded chain in which contacts open and close all the time."""
    chain = lmpchain.Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    speed = chain.equilibrium_overlap[0] * chain.band_edge
    velocity = np.append(np.random.default_rng(grains).normal(size=grains - 1) * speed, 0.0)
    duration = steps * REACH / chain.band_edge
    return lmpchain.Scene(
        chain=chain,
        excitation=lmpchain.Profile(velocity=velocity),
        duration=duration,
        samples=2,
        grains="1:2",
    )


def run(
    scene: lmpchain.Scene, name: str, adaptive: bool, steps: int, threads: int
) -> tuple[float, float, bytes]:
    """Return the integration time of a scene, s, its grain-steps, and its final positions."""
    method = METHODS[name]
    schedule = Steps(steps, 1, scene.duration / steps, adaptive)
    stepper = NativeStepper(ChainBatch([scene]), method, schedule, {}, threads)
    u, v = np.zeros((2, 1, 2, scene.chain.grains))
    began = time.perf_counter()
    stepper.fill(u, v, 0, 1, 2**30)
    took = time.perf_counter() - began
    stepper.close()
    made: NDArray[np.float64] = stepper.steps
    return took, float(made[0]) * method.evaluations * scene.chain.grains, u.tobytes() + v.tobytes()


def main() -> None:
    """Print the table."""
    cores = len(os.sched_getaffinity(0))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--threads", type=int, nargs="+", default=[2**k for k in range(1, cores.bit_length())]
    )
    parser.add_argument("--grains", type=int, nargs="+", default=[10**4, 10**5, 10**6])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--work", type=float, default=1e9, help="grain-steps of a run (default: %(default)g)"
    )
    given = parser.parse_args()
    several = [1, *sorted({*given.threads} - {1})]
    print(
        f"{'grains':>9}  {'method':<16}{'one, M/s':>9}"
        + "".join(f"{f'{count} threads':>12}" for count in several[1:])
    )
    for grains in given.grains:
        for name, adaptive in (("verlet", False), ("rkn6", False), ("rkn6", True)):
            steps = (
                int(given.work / grains / METHODS[name].evaluations / (MORE if adaptive else 1)) + 1
            )
            scene = shaken(grains, steps) if adaptive else stirred(grains, steps)[0]
            found = [
                [run(scene, name, adaptive, steps, count) for count in several]
                for _ in range(given.repeats)
            ]
            if len({bits for row in found for *_, bits in row}) > 1:
                raise SystemExit(f"{name} on {grains} grains: the answers differ")
            one, *others = np.array([[took for took, *_ in row] for row in found]).min(0)
            gains = "".join(f"{one / other:>11.2f}x" for other in others)
            method = f"{name}, adaptive" if adaptive else name
            print(
                f"{grains:>9,}  {method:<16}{found[0][0][1] / one / 1e6:>9.0f}{gains}", flush=True
            )


if __name__ == "__main__":
    main()
