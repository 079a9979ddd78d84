"""What is compiled, or loaded from what was compiled before, is no part of what an integration costs."""

import json
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from helpers.example_scenes import paper

from lmpchain import simulate
from lmpchain.trajectory.record import Cost
from lmpchain.util.compilation import clock, compiled_s

TWICE = """
import json, sys, warnings
import lmpchain
warnings.simplefilter("ignore")
chain = lmpchain.Chain(grains=60, diameter=1e-3)
scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-7), duration=5e-5, samples=101)
costs = [lmpchain.simulate(scene, sys.argv[1], 0.5).cost for _ in range(5)]
print(json.dumps([vars(cost) for cost in costs]))
"""


def test_the_clock_stands_still_while_something_is_compiled():
    made = numba.njit(lambda x: np.sort(x)[::-1] + np.cumsum(x))
    before, compiled = clock(), compiled_s()
    made(np.ones(3))
    spent = compiled_s() - compiled
    assert spent > 0
    assert clock() - before < spent  # it takes a second to compile, and next to nothing to run
    compiled = compiled_s()
    made(np.ones(3))
    assert compiled_s() == compiled


def test_costs_of_old_files_have_no_compilation():
    cost = simulate(paper("weak", 5), "native", 1e-2).cost
    old = {key: value for key, value in vars(cost).items() if key != "compile_s"}
    assert Cost(**json.loads(json.dumps(old))).compile_s == 0


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "modes", "chebyshev", "bessel", "continuum", "auto"])
def test_the_first_run_on_a_new_machine_costs_what_the_next_one_does(engine, tmp_path):
    """With nothing compiled before; the first, which meets cold caches, may take twenty times as long."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", TWICE, engine]
    for compiles in (True, False):  # and in the next process, which loads what this one kept
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        first, *rest = json.loads(run.stdout)
        assert first["integration_s"] < 20 * max(cost["integration_s"] for cost in rest)
        assert first["compile_s"] > (1.0 if compiles else 0.0)
        assert all(cost["compile_s"] == 0 for cost in rest)
