"""CPU time of LAMMPS through the package against stand-alone `lmp` on the same deck, interleaved.

The time of the package is that of a whole `simulate`, with the error estimate; that of `lmp` is the
whole process, with its dump.
"""

import argparse
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import lmpchain
from lmpchain.engines.lammps.export import write_deck


def cpu(who: int) -> float:
    """Return user plus system time so far, s."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Run both in turn and print the ratio of every pair."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grains", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    step = 1e-7
    chain = lmpchain.Chain(grains=arguments.grains, material="glass", diameter=1e-3)
    velocity = np.random.default_rng(1).uniform(-1e-4, 1e-4, arguments.grains)
    velocity[-1] = 0.0  # grain N is held; all others move and are computed
    scene = lmpchain.Scene(
        chain=chain,
        excitation=lmpchain.Profile(velocity=velocity),
        duration=arguments.steps * step,
        samples=11,
    )
    engine = lmpchain.engines.Lammps(integrator="verlet", step=step, diameter="physical")
    lmp = shutil.which("lmp") or str(Path(sys.executable).with_name("lmp"))
    # loads libraries
    lmpchain.simulate(lmpchain.Scene(**scene.given() | {"duration": 10 * step}), engine=engine)
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        write_deck(scene, folder, step=step)
        for _ in range(arguments.runs):
            before = cpu(resource.RUSAGE_CHILDREN)
            subprocess.run([lmp, "-in", "in.column", "-screen", "none"], cwd=folder, check=True)
            alone = cpu(resource.RUSAGE_CHILDREN) - before
            before = cpu(resource.RUSAGE_SELF)
            lmpchain.simulate(scene, engine=engine)
            inside = cpu(resource.RUSAGE_SELF) - before
            ratios.append(inside / alone)
            print(f"lmp {alone:.2f} s, lmpchain {inside:.2f} s of CPU: ratio {ratios[-1]:.3f}")
    print(f"median ratio {statistics.median(ratios):.3f}")


if __name__ == "__main__":
    main()
