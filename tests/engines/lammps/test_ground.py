"""Chains on a ground in LAMMPS: against the native engine, decks, ranks, stops."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.checked_lammps import check_agreement, check_deck, check_resumed

from lmpchain import Chain, Displacement, Drive, Force, Impulse, InputError, Law, Scene, laws
from lmpchain.engines import Lammps
from lmpchain.engines.lammps.export import write_deck

ROW: dict[str, Any] = {"grains": 12, "diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
OWN = np.linspace(1e5, 1e6, 12).tolist()
FORMULA = Law("k*max(o, 0)**1.5*(1 + c*o)", c=1e4)
MATHIEU = laws.mathieu(1e6, depth=0.6, frequency=2e5)
GROUNDS = {
    "spring": Law("k*u", k=3e5),
    "one spring a grain": Law("k*u", k=OWN),
    "Duffing": Law("k*u + b*u**3", k=OWN, b=1e21),
    "Klein-Gordon": laws.klein_gordon(k=1e5, beta=1e20),
    "Frenkel-Kontorova": laws.frenkel_kontorova(1e6, period=1e-8),
    "Mathieu": MATHIEU,
    "hyperbolic tangent": Law("f*tanh(u/c)", f=1e-2, c=1e-8),
    "grows in time": Law("k*u*(2 + tanh(w*t - 3))*exp(-max(k, 5e5)*t/k)", k=OWN, w=1e5),
}
ACTING = {
    "strike": Impulse(velocity=1e-3),
    "displaced": Displacement(displacement=1e-8, grain=3),
    # The push ends within a step.
    "push": Force(grain=3, amplitude=0.1, shape="half-sine", duration=4.03e-6),
    "drive": Drive(amplitude=1e-8, frequency=1e5),
}
HOSTS: dict[str, dict[str, Any]] = {
    "formula": {"law": FORMULA},
    "drag": {"damping": {"drag": 1e4}},
    "viscous": {"damping": {"viscoelastic": 1e-8}},
    "under gravity": {"gravity": 9.81, "top_load": 0.0},
    "walls": {"top": "wall", "bottom": "wall"},
}


def scene_on(ground: Law, acting: str = "strike", **chain: Any) -> tuple[Scene, float]:
    """Return a scene on a ground, and a step of velocity Verlet, s."""
    made = Chain(**ROW | chain, ground=ground)
    duration = 10 * made.time_scale
    scene = Scene(chain=made, excitation=ACTING[acting], duration=duration, samples=11)
    return scene, scene.sampling_interval / 20


@pytest.mark.parametrize("name", GROUNDS)
def test_lammps_and_native_differ_by_less_than_1e_10_at_the_same_steps(name: str):
    check_agreement(*scene_on(GROUNDS[name]), within=0.05)


@pytest.mark.parametrize(
    ("name", "host"),
    [("spring", "formula"), ("Duffing", "drag"), ("Mathieu", "viscous"),
     ("Duffing", "under gravity"), ("Mathieu", "walls")],
)  # fmt: skip
def test_in_other_chains(name: str, host: str):
    check_agreement(*scene_on(GROUNDS[name], **HOSTS[host]), within=0.05)


@pytest.mark.parametrize("name", ["spring", "Mathieu"])
@pytest.mark.parametrize("acting", ["displaced", "push", "drive"])
def test_with_other_excitations(name: str, acting: str):
    check_agreement(*scene_on(GROUNDS[name], acting), within=0.05)


@pytest.mark.parametrize("integrator", ["rkn6", "kahan-li6"])
@pytest.mark.parametrize("acting", ["strike", "push"])
def test_splittings_meet_the_ground_at_their_times(integrator: str, acting: str):
    """The native engine keeps the order (see `tests/chain/test_ground.py`)."""
    scene, step = scene_on(MATHIEU, acting)
    check_agreement(scene, 4 * step, integrator, within=0.05)


@pytest.mark.parametrize(
    ("name", "acting", "integrator"),
    [
        ("spring", "strike", "verlet"),
        ("Duffing", "displaced", "verlet"),
        ("Mathieu", "push", "verlet"),
        ("Duffing", "strike", "kahan-li6"),
    ],
)
def test_a_deck_alone_gives_the_bytes_of_the_library(
    name: str, acting: str, integrator: str, tmp_path: Path
):
    scene, step = scene_on(GROUNDS[name], acting)
    step = step if integrator == "verlet" else 4 * step
    check_deck(scene, tmp_path, step=step, integrator=integrator)


def test_a_deck_of_a_composition_cannot_tell_the_time(tmp_path: Path):
    scene, step = scene_on(MATHIEU)
    with pytest.raises(InputError, match="verlet in a deck with a time-dependent ground"):
        write_deck(scene, tmp_path, step=step, integrator="kahan-li6")


@pytest.mark.parametrize(
    ("name", "acting", "integrator"),
    [("Mathieu", "strike", "verlet"), ("spring", "displaced", "rkn6")],
)
def test_a_resumed_run_gives_the_same_bits(
    name: str, acting: str, integrator: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    scene, step = scene_on(GROUNDS[name], acting)
    check_resumed(scene, Lammps(integrator, 2 * step, "gauge"), tmp_path / "run", monkeypatch)
