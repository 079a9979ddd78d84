"""Threads that share a chain give the bits of one thread."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, Drive, Force, Law, Profile, Scene, engines, simulate
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels.layout import LEAST_SHARE
from lmpchain.integrators.methods import METHODS, SPLITTINGS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

GRAINS = 5 * LEAST_SHARE + 21
SEVERAL = (2, 3, 5)
PUSHED = GRAINS // 4


def noisy(
    grains: int = GRAINS,
    first: int = 0,
    last: int | None = None,
    seed: int = 1,
    strikes: float = 0.0,
    **chain: Any,
) -> Scene:
    """Return a chain of flying grains, so that contacts open and close everywhere."""
    made = Chain(grains=grains, diameter=1e-3, **{"gravity": 0.0, "top_load": 1e-3} | chain)
    speed = strikes or 2 * made.equilibrium_overlap[0] * made.band_edge
    velocity = np.zeros(grains)
    velocity[first:last] = (
        np.random.default_rng(seed).normal(size=velocity[first:last].size) * speed
    )
    velocity[-1] = 0
    duration = 1e-4 if strikes else 4 / made.band_edge
    return Scene(chain=made, excitation=Profile(velocity=velocity), duration=duration, samples=3)


def acted(grains: int = GRAINS // 2 + 200, **excitation: Any) -> Scene:
    """Return a chain that is driven or pushed until the wave has filled a large part of it."""
    pushed = excitation.pop("pushed", False)
    chain = Chain(
        grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3, top="free" if pushed else "wall"
    )
    moved = Force if pushed else Drive
    duration = 2 * 2.2 * LEAST_SHARE / chain.band_edge
    return Scene(chain=chain, excitation=moved(**excitation), duration=duration, samples=3)


def answer(
    scene: Scene,
    threads: int,
    method: str,
    adaptive: bool,
    steps: int = 4,
    force: str = "auto",
    initial: Any = None,
) -> list[Any]:
    """Return the samples and the final state, computed in pieces of three steps."""
    schedule = Steps(steps, 1, scene.duration / (scene.samples - 1) / steps, adaptive)
    batch = ChainBatch([scene], force, initial)
    stepper = NativeStepper(batch, METHODS[method], schedule, {}, threads)
    u, v = np.zeros((2, 1, scene.samples, scene.chain.grains))
    made = 0
    while stepper.sample < scene.samples - 1:
        made += stepper.fill(u, v, 0, scene.samples - 1, 3 if steps < 50 else 777)
    assert made == stepper.steps[0]
    kept = stepper.state()
    stepper.close()
    assert len(stepper.teams) == threads
    return [u, v, kept["u"], kept["v"], kept["state"]]


def check_alike(
    scene: Scene, *how: Any, several: Sequence[int] = SEVERAL, **more: Any
) -> list[Any]:
    """Return the result of one thread, after checking that several threads give the same."""
    one = answer(scene, 1, *how, **more)
    for threads in several:
        for a, b in zip(one, answer(scene, threads, *how, **more), strict=True):
            assert np.array_equal(a, b)
    return one


@pytest.mark.parametrize("adaptive", [False, True])
def test_contacts_that_open_and_close(adaptive: bool):
    scene = noisy()
    u = check_alike(scene, "rkn4", adaptive, several=(3,) if adaptive else SEVERAL)[0][0, -1]
    assert (scene.chain.equilibrium_overlap + u[:-1] - u[1:] < 0).mean() > 0.05


@pytest.mark.parametrize(
    ("method", "adaptive", "grain"),
    [
        ("verlet", False, 0),
        ("verlet", False, LEAST_SHARE + 44),
        ("rkn4", True, 1),
        ("rkn4", True, 2 * LEAST_SHARE),
    ],
    ids=["wall", "force near the border", "grain 1", "force in the second part"],
)
def test_a_forcing_of_a_chain_that_moves_everywhere(method: str, adaptive: bool, grain: int):
    """The two threads share the chain from the beginning."""
    scene = noisy(2 * LEAST_SHARE + 100, top="wall")
    overlap = float(scene.chain.equilibrium_overlap[0])
    frequency = 0.05 * scene.chain.band_edge
    forced = scene.replace(
        excitation=Force(frequency=frequency, amplitude=0.1, grain=grain)
        if grain > 1
        else Drive(frequency=frequency, amplitude=10 * overlap, grain=grain)
    )
    initial = tuple(field[None] for field in scene.initial())
    one = check_alike(forced, method, adaptive, several=(2,), initial=initial)
    free = answer(scene, 1, method, adaptive)
    changed = np.abs(one[0][0, -1] - free[0][0, -1])
    assert changed.argmax() == pytest.approx(grain - 1, abs=3)
    assert changed.max() > overlap


def test_a_law_by_formula_and_a_ground_that_changes_in_time():
    law = Law("k*max(o, 0)**p", p=[1.5] * (GRAINS - 1))
    ground = Law("k*u*(1 + 0.9*tanh(w*t - 3))", k=[1e5] * GRAINS, w=1e6)
    check_alike(noisy(law=law, ground=ground), "verlet", False, several=(3,))


@pytest.mark.parametrize(
    "force",
    [pytest.param("exact", marks=pytest.mark.slow), pytest.param("plain", marks=pytest.mark.soak)],
)
@pytest.mark.parametrize(
    "method",
    [
        pytest.param(name, marks=() if name in ("verlet", "rkn6") else pytest.mark.soak)
        for name in SPLITTINGS
    ],
)
def test_every_splitting(method: str, force: str):
    for adaptive in {False, METHODS[method].adaptive}:
        check_alike(noisy(seed=2), method, adaptive, force=force)


@pytest.mark.slow
@pytest.mark.parametrize(
    "chain",
    [
        {"exponent": 1.0},
        {"exponent": 1.3},
        {"exponent": 2.5, "top": "wall"},
        {"top_load": 0.0, "gravity": 9.81, "top": "wall"},
        {"top_load": 0.0, "bottom": "free", "strikes": 1e-3},
    ],
)
def test_every_form_of_the_force(chain: dict[str, Any]):
    scene = noisy(**chain)
    check_alike(scene, "verlet", False)
    check_alike(scene, "rkn6", False)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["verlet", "rkn4"])
def test_a_growing_window_uses_more_threads(method: str):
    cases = ((0, 2, METHODS[method].adaptive), (3000, 3, False))
    for first, threads, adaptive in cases:
        scene = noisy(3 * LEAST_SHARE, first, first + 2 * LEAST_SHARE - 40).replace(
            duration=1e-3, samples=3
        )
        how = {"steps": 300}
        one = answer(scene, 1, method, adaptive, **how)
        assert one[4]["last"][0] - one[4]["first"][0] > 2 * LEAST_SHARE + 200
        for a, b in zip(one, answer(scene, threads, method, adaptive, **how), strict=True):
            assert np.array_equal(a, b)


TONE = {"amplitude": 1e-8, "frequency": 3000.0}
PUSH = {"amplitude": 1e-3, "grain": PUSHED, "pushed": True}
LASTING: list[dict[str, Any]] = [
    TONE,
    TONE | {"cycles": 5, "grain": 0},
    {"times": [0, 0.01, 0.02, 0.04], "displacement": [0, 2e-8, 1e-8, 0]},
    PUSH | {"duration": 3e-4, "shape": "half-sine"},
]


@pytest.mark.parametrize(
    "number",
    [pytest.param(0, marks=pytest.mark.slow)]
    + [pytest.param(number, marks=pytest.mark.soak) for number in (1, 2, 3)],
)
def test_a_lasting_forcing(number: int):
    excitation = LASTING[number]
    scene = acted(**excitation)
    for method, adaptive in (("verlet", False), ("rkn4", True)):
        steps = int(np.ceil(scene.chain.band_edge * scene.duration / 2))
        one = check_alike(scene, method, adaptive, several=(2,), steps=steps)
        assert one[4]["last"][0] > 2 * LEAST_SHARE


@pytest.mark.slow
def test_whole_runs_and_resumed_runs(monkeypatch: pytest.MonkeyPatch):
    """Trajectory, error estimate and checkpoint do not depend on the threads."""
    scene = noisy(2 * LEAST_SHARE + 5, bottom="wall")
    scene = scene.replace(samples=11, duration=scene.duration / 16)
    one, two = (simulate(scene, "native", 1e-4, threads=threads) for threads in (1, 2))
    for field in ("displacement", "velocity"):
        assert np.array_equal(getattr(one, field), getattr(two, field))
    assert one.error_estimate == two.error_estimate
    assert one.cost.steps == two.cost.steps

    monkeypatch.setattr(stepping_run, "BLOCK_BYTES", 1)  # Few samples per block.

    def run(threads: int, kept: Any = None, stop: int = scene.samples) -> tuple[Any, Any]:
        engine = engines.Native("rkn4", threads=threads)
        proposal = engine.propose(scene, 1e-3)
        # Without sampled steps the run has a single landing at its end.
        started = engine.start([scene], proposal.with_steps(proposal.steps.sampled), kept)
        blocks = []
        for block in started.blocks():
            blocks += [block.velocity[0]]
            if block.samples.stop >= stop:
                break
        kept = started.state()
        started.close()
        return np.concatenate(blocks), kept

    whole, end = run(1)
    for threads, others in ((1, 2), (2, 1), (2, 2)):
        kept = run(threads, stop=1)[1]
        rest, ended = run(others, kept)
        assert np.array_equal(whole[len(whole) - len(rest) :], rest)
        assert all(np.array_equal(end[name], ended[name]) for name in end)


def test_no_thread_waits_for_a_missing_thread(monkeypatch: pytest.MonkeyPatch):
    """Ctrl-C may arrive when some threads have begun and others have not."""
    scene = noisy()
    stepper = NativeStepper(
        ChainBatch([scene]), METHODS["verlet"], Steps(2, 1, scene.duration / 6, False), {}, 3
    )
    submit = ThreadPoolExecutor.submit
    begun = []

    def interrupted(*work: Any) -> Any:
        if begun:
            raise KeyboardInterrupt
        begun.append(submit(*work))
        return begun[0]

    monkeypatch.setattr(ThreadPoolExecutor, "submit", interrupted)
    u, v = np.zeros((2, 1, scene.samples, GRAINS))
    with pytest.raises(KeyboardInterrupt):
        stepper.fill(u, v, 0, scene.samples - 1, 2**30)
    stepper.close()  # This call waits for the threads that have begun.
    assert begun[0].done()
