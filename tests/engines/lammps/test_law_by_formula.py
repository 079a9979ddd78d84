"""Contact laws by formula in LAMMPS: native engine and SciPy, decks, ranks, stops."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.checked_lammps import check_agreement, check_deck, check_resumed
from scipy.integrate import solve_ivp

from lmpchain import Chain, Drive, Force, Impulse, Law, Scene, laws, simulate
from lmpchain.engines import Lammps
from lmpchain.engines.lammps.engine import gauge_diameter

ROW: dict[str, Any] = {"grains": 12, "diameter": 1e-3, "gravity": 0.0}
K = 1e3  # Contact constant, N/m.
STRIKE = Impulse(velocity=0.02)
WEAKER = Impulse(velocity=0.01)
CUBIC = Law("k*max(o, 0)**1.5*(1 + c*o)", c=1e4)
MANY = Law("k*max(o, 0)**p", k=1e6, p=np.linspace(1.3, 1.7, 11).tolist())
UNLIKE = np.linspace(1e3, 2e3, 11).tolist()
WEAK, SOFT, ADHESIVE = (
    laws.power(0.6, k=10.0),
    laws.softening(1e-6, k=K),
    laws.dmt(1e-3, 1e-7, k=5e8),
)
WALLS: dict[str, Any] = {"top": "wall", "bottom": "wall", "top_load": 0.01}
TODA = laws.toda(1e5, k=K)
FPUT = laws.fput(1e7, 1e14, k=K)
PUSH = Force(grain=3, shape="half-sine", amplitude=1e-3, duration=1e-4)
CASES: dict[str, tuple[dict[str, Any], Any, float]] = {
    "toda": ({"law": TODA}, Impulse(velocity=0.2), 2e-4),
    "toda under gravity": ({"law": TODA, "gravity": 9.81}, Impulse(velocity=0.2), 2e-4),
    "fput": ({"law": FPUT}, STRIKE, 5e-4),
    "fput, pushed": ({"law": FPUT}, PUSH, 1.5e-4),
    "fput, driven": ({"law": FPUT}, Drive(amplitude=1e-7, frequency=5e3), 1.5e-4),
    "springs": ({"law": Law("A*o", A=K)}, STRIKE, 5e-4),
    "bilinear": ({"law": laws.bilinear(0.3, k=K)}, STRIKE, 5e-4),
    "an exponent below 1": ({"law": WEAK, "top_load": 1e-3}, Impulse(velocity=0.002), 1.5e-4),
    "softening": ({"law": SOFT, "top_load": 3e-4}, Impulse(velocity=0.005), 2.5e-4),
    "one exponent a contact": ({"law": MANY, "gravity": 9.81}, WEAKER, 5e-4),
    "Hertz": ({"law": Law("k*max(o, 0)**1.5", k=5e8), "gravity": 9.81}, WEAKER, 1e-4),
    "stiffer than Hertz": ({"law": CUBIC, "gravity": 9.81}, WEAKER, 1e-4),
    "exponent 2.5": ({"law": laws.power(2.5, k=1e13), "top_load": 0.01}, WEAKER, 1e-4),
    "adhesion": ({"law": ADHESIVE, "top_load": 0.01}, Impulse(velocity=0.003), 5e-5),
    "polynomial": ({"law": Law("k*o + b*o**3 + c*o**5", k=K, b=1e13, c=1e24)}, STRIKE, 5e-4),
    "bistable": ({"law": laws.bistable(1e-4, 2e-4, k=K)}, STRIKE, 5e-4),
    "unlike springs": ({"law": Law("k*o + b*o**3", k=UNLIKE, b=1e13)}, STRIKE, 5e-4),
    "drag": ({"law": TODA, "damping": {"drag": 300.0}}, STRIKE, 5e-4),
    "walls": ({"law": CUBIC, "gravity": 9.81, **WALLS}, WEAKER, 1e-4),
}
MOVED = [f"{name} + moving wall" for name in CASES if isinstance(CASES[name][1], Impulse)]
VISCOUS = [f"{name} + viscous" for name in CASES]
BOTH = "stiffer than Hertz + moving wall + viscous"
NAMES = [*CASES, *MOVED, *VISCOUS, BOTH]
DEFAULT = ("drag", "toda under gravity", "adhesion", "toda under gravity + viscous", BOTH)


def case(name: str) -> tuple[Scene, float]:
    """Return a scene and a step, s."""
    plain, *others = name.split(" + ")
    chain, excitation, duration = CASES[plain]
    scene = Scene(chain=Chain(**ROW | chain), excitation=excitation, duration=duration, samples=11)
    omega = scene.highest_frequency
    if "moving wall" in others:
        walls = scene.chain.replace(top="wall", bottom="wall")
        drive = Drive(grain=0, amplitude=0.01 / omega, frequency=omega / 30, cycles=3)
        scene = scene.replace(chain=walls, excitation=drive)
    if "viscous" in others:
        damping = scene.chain.damping.replace(viscoelastic=0.05 / omega)
        scene = scene.replace(chain=scene.chain.replace(damping=damping))
    return scene, duration / 250


def short_case(name: str) -> tuple[Scene, float]:
    """Return the first part of a scene, and a step, s."""
    scene, step = case(name)
    return scene.replace(duration=0.4 * scene.duration, samples=5), 2 * step


def some(names: tuple[str, ...], among: list[str] = NAMES) -> list[Any]:
    """Return cases: these by default, an eighth of the others as slow, the rest as soak tests."""
    others = [pytest.mark.soak if n % 8 else pytest.mark.slow for n in range(len(among))]
    return [
        pytest.param(name, marks=() if name in names else mark)
        for name, mark in zip(among, others, strict=True)
    ]


@pytest.mark.parametrize("name", some(DEFAULT))
def test_lammps_and_native_differ_by_less_than_1e_10_at_the_same_steps(name: str):
    scene, step = case(name)
    check_agreement(scene, step)


@pytest.mark.parametrize(
    "name", some(("toda + moving wall",), [name for name in MOVED if "drag" not in name])
)
def test_drifts_of_a_splitting_end_at_the_wall(name: str):
    scene, step = short_case(name)
    check_agreement(scene, step, "rkn6")


def test_a_wall_follows_a_curve_through_points():
    scene, step = case(BOTH)
    time = np.linspace(0.0, 0.7 * scene.duration, 15)
    curve = scene.excitation.waveform.at(time)
    drive = Drive(grain=0, times=time, displacement=curve - curve[0])
    check_agreement(scene.replace(excitation=drive), step)


REFERENCES: dict[str, Callable[[Any], Any]] = {
    "toda": lambda o: K * np.expm1(1e5 * o) / 1e5,
    "fput": lambda o: K * o - 1e7 * o**2 + 1e14 * o**3,
    "polynomial": lambda o: K * o + 1e13 * o**3 + 1e24 * o**5,
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n != "toda" else ()) for n in REFERENCES]
)
def test_the_estimate_covers_the_error_against_scipy(name: str):
    scene, step = case(name)
    m = scene.chain.masses

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        u, v = state.reshape(2, -1)
        force = REFERENCES[name](u[:-1] - u[1:])
        pull = (np.append(0.0, force) - np.append(force, 0.0)) / m
        # The last grain is fixed.
        return np.concatenate((v, np.append(pull[:-1], 0.0)))

    start = np.concatenate(scene.initial())
    span = 0, scene.duration
    solution = solve_ivp(rates, span, start, "DOP853", scene.time, rtol=1e-12, atol=1e-22)
    wanted = solution.y[scene.chain.grains :].T
    t = simulate(scene, Lammps(integrator="verlet", step=step, diameter="gauge"))
    error = np.abs(t.velocity - wanted).max() / np.abs(wanted).max()
    # Velocity Verlet has an error at this step, which the estimate predicts.
    assert 1e-7 < error <= 1.1 * t.error_estimate.solver


@pytest.mark.parametrize("name", some(("toda under gravity", BOTH)))
def test_a_deck_gives_the_bytes_of_the_library(name: str, tmp_path: Path):
    scene, step = short_case(name)
    check_deck(scene, tmp_path, step=step)


def test_bonds_that_are_stretched_at_rest_have_a_gauge_diameter():
    """The grains themselves are used if they are not larger."""
    for stretch, gauge in ((1e-6, 3e-6), (4e-4, 0.0)):
        chain = Chain(**ROW, law=Law("k*(o + e)", k=K, e=stretch))
        scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=1e-4, samples=3)
        assert gauge_diameter(scene) == pytest.approx(gauge)


def test_rkn6_meets_a_tolerance():
    scene, _ = case("toda")
    t = simulate(scene, "lammps", tolerance=1e-8)
    exact = simulate(scene, "native", tolerance=1e-11)
    largest = np.abs(exact.velocity).max()
    assert np.abs(t.velocity - exact.velocity).max() < 1e-8 * largest
    assert t.cost.integrator == "rkn6"


def test_the_expected_time_counts_the_formula_of_every_contact():
    """LAMMPS parses each different formula at every force evaluation."""

    def work(diameter: Any) -> float:
        chain = Chain(grains=20, diameter=diameter, law=CUBIC)
        scene = Scene(chain=chain, excitation=STRIKE, duration=1e-4)
        lammps = Lammps("verlet", 1e-6)
        return lammps.propose(scene, 1e-3).cost_s - lammps.start_up_s

    assert work(np.linspace(1e-3, 1.2e-3, 20)) == pytest.approx(19 * work(1e-3), rel=0.1)


@pytest.mark.parametrize("name", some((BOTH,)))
def test_a_resumed_run_gives_the_same_bits(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    scene, step = case(name)
    check_resumed(scene, Lammps("verlet", 2 * step, "gauge"), tmp_path / "run", monkeypatch)
