"""Many runs in one process do not increase memory or the number of open files."""

import gc

import psutil
import pytest
from helpers.example_scenes import smooth

from lmpchain import engines, simulate

RUNS = 100
WARM = 20


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"integrator": "verlet"}])
def test_lammps_runs_leak_nothing(options):
    scene = smooth(samples=11)
    process = psutil.Process()
    seen = {}
    for run in range(1, RUNS + 1):
        simulate(scene, engines.Lammps(**options), 1e-4)
        if run in (WARM, RUNS):
            gc.collect()
            seen[run] = process.memory_info().rss, process.num_fds(), len(process.children())
    print({run: (f"{memory / 2**20:.1f} MB", *rest) for run, (memory, *rest) in seen.items()})
    (before, *held), (after, *left) = seen.values()
    assert after - before < 4 * 2**20
    assert left == held
