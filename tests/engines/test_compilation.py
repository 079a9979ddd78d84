"""Compilation and loading of cached code are not part of the cost of an integration."""

import json
import os
import subprocess
import sys

import numba
import pytest
from helpers.example_scenes import paper
from numba.core.event import Listener, install_listener

from lmpchain import simulate
from lmpchain.trajectory.record import Cost
from lmpchain.util.compilation import clock, compiled_s

# A simulated clock: reading it takes a microsecond, a compilation or a load takes 1000 s.
COUNTED = """
import itertools, json, sys, time, warnings
from numba.core.event import Listener, register
now, looks, events = [0.0], itertools.count(), {"numba:compiler_lock": 0, "numba:compile": 0}
time.perf_counter = lambda: now[0] + 1e-6 * next(looks)
# with a listener that starts before the next one
from lmpchain import Chain, Impulse, Scene, simulate
class Slow(Listener):
    depth = 0
    def on_start(self, event):
        events[event.kind] += 1
        if event.kind == "numba:compiler_lock":
            now[0] += 1000.0 * (self.depth == 0)
            self.depth += 1
    def on_end(self, event):
        self.depth -= event.kind == "numba:compiler_lock"
slow = Slow()
for kind in events:
    register(kind, slow)
warnings.simplefilter("ignore")
chain = Chain(grains=60, diameter=1e-3)
scene = Scene(chain=chain, excitation=Impulse(velocity=1e-7), duration=5e-5, samples=101)
rows = []
for _ in range(2):
    began, before = now[0], dict(events)
    cost = simulate(scene, sys.argv[1], 0.5).cost
    counts = {kind: events[kind] - before[kind] for kind in events}
    rows.append(cost._asdict() | {"spent": now[0] - began} | counts)
print(json.dumps(rows))
"""


def test_the_clock_stops_during_compilation(monkeypatch):
    """A compilation of 1000 s by the simulated clock takes no time by the package's clock."""
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])

    class Slow(Listener):
        def on_start(self, event):
            now[0] += 1000.0

        def on_end(self, event):
            pass

    made = numba.njit(lambda x: 2 * x)
    before = clock()
    compiled = compiled_s()
    with install_listener("numba:compile", Slow()):
        made(1.5)
        spent = now[0]
        assert spent >= 1000
        assert (clock() - before, compiled_s() - compiled) == pytest.approx((0, spent), abs=1e-9)
        made(1.5)
    assert now[0] == spent == pytest.approx(compiled_s() - compiled, abs=1e-9)


def test_costs_of_old_files_have_no_compilation():
    cost = simulate(paper("weak", 5), "native", 1e-2).cost
    old = {key: value for key, value in cost._asdict().items() if key != "compile_s"}
    assert Cost(**json.loads(json.dumps(old))).compile_s == 0


QUICK = ("modes",)
LONG = ("auto", "native", "chebyshev", "bessel", "continuum")


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(name, marks=pytest.mark.slow if name in QUICK else pytest.mark.soak)
        for name in QUICK + LONG
    ],
)
def test_compilation_on_a_new_machine_is_not_counted_as_cost(engine, tmp_path):
    """Loading of cached code in the next process is not counted either.

    A second run in one process compiles nothing.
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COUNTED, engine]
    for compiles in (True, False):
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        first, second = json.loads(run.stdout)
        assert (first["numba:compile"] > 0) == compiles
        assert first["spent"] >= 1000
        assert first["compile_s"] == pytest.approx(first["spent"], abs=1)
        assert (second["numba:compiler_lock"], second["compile_s"]) == (0, 0)
        for cost in first, second:
            assert 0 < cost["integration_s"] + cost["estimate_s"] + cost["setup_s"] < 1


TWINS = """
import numba
from lmpchain.util.compilation import compiled_once

def made(step):
    @numba.njit
    def climb(x, n):
        return x if n == 0 else climb(x + step, n - 1)
    return climb

_by_one, _by_two = made(1.0), made(2.0)

@compiled_once("one", 1)
def by_one(n):
    return _by_one(0.0, n)

@compiled_once("two", 1)
def by_two(n):
    return _by_two(0.0, n)
"""


@pytest.mark.slow
def test_functions_compiled_by_two_processes_are_distinguished_by_a_third(tmp_path):
    """Functions from one factory have equal names.

    Numba tells them apart by a number that starts anew.
    """
    (tmp_path / "twins.py").write_text(TWINS)
    said = [
        subprocess.run(
            [sys.executable, "-c", f"from twins import *; print({call})"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        ).stdout
        for call in ("by_one(7)", "by_two(7)", "by_one(7), by_two(7)")
    ]
    assert said == ["7.0\n", "14.0\n", "7.0 14.0\n"]
