"""Chains on a ground in LAMMPS: against the native engine, decks, ranks, stops."""

import filecmp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.standalone_lammps import lmp, read_dump
from helpers.stopped_runs import stop_three_times

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    InputError,
    Law,
    Scene,
    laws,
    simulate,
)
from lmpchain.engines import Lammps, Native
from lmpchain.engines.lammps.deck_reader import read_deck
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


def check_agreement(scene: Scene, step: float, integrator: str = "verlet") -> None:
    """Check that both engines agree at the same steps, but for the rounding of heights."""
    native = simulate(scene, Native(integrator=integrator, step=step))
    ours = simulate(scene, Lammps(integrator, step=step, diameter="gauge"))
    largest = np.abs(native.velocity).max()
    assert native.cost.steps == ours.cost.steps
    assert np.abs(native.velocity - ours.velocity).max() < 1e-10 * largest
    assert ours.error_estimate.solver == pytest.approx(native.error_estimate.solver, rel=0.05)


@pytest.mark.parametrize("name", GROUNDS)
def test_lammps_and_native_differ_by_less_than_1e_10_at_the_same_steps(name: str):
    check_agreement(*scene_on(GROUNDS[name]))


@pytest.mark.parametrize(
    ("name", "host"),
    [
        ("spring", "formula"),
        ("Duffing", "drag"),
        ("Mathieu", "viscous"),
        ("Duffing", "under gravity"),
        ("Mathieu", "walls"),
    ],
)
def test_in_other_chains(name: str, host: str):
    check_agreement(*scene_on(GROUNDS[name], **HOSTS[host]))


@pytest.mark.parametrize("name", ["spring", "Mathieu"])
@pytest.mark.parametrize("acting", ["displaced", "push", "drive"])
def test_with_other_excitations(name: str, acting: str):
    check_agreement(*scene_on(GROUNDS[name], acting))


@pytest.mark.parametrize("integrator", ["rkn6", "kahan-li6"])
@pytest.mark.parametrize("acting", ["strike", "push"])
def test_splittings_meet_the_ground_at_their_times(integrator: str, acting: str):
    """The native engine keeps the order (see `tests/chain/test_ground.py`)."""
    scene, step = scene_on(MATHIEU, acting)
    check_agreement(scene, 4 * step, integrator)


def test_a_tolerance_is_met():
    scene, _ = scene_on(GROUNDS["Duffing"])
    answer = simulate(scene, "lammps", tolerance=1e-7)
    exact = simulate(scene, "native", tolerance=1e-11)
    assert np.abs(answer.velocity - exact.velocity).max() < 1e-7 * np.abs(exact.velocity).max()


@pytest.mark.parametrize(
    ("name", "acting"), [("spring", "strike"), ("Duffing", "displaced"), ("Mathieu", "push")]
)
def test_a_deck_alone_gives_the_bytes_of_the_library(name: str, acting: str, tmp_path: Path):
    scene, step = scene_on(GROUNDS[name], acting)
    write_deck(scene, tmp_path / "deck", step=step)
    lmp(tmp_path / "deck", "-screen", "none")
    engine = Lammps("verlet", step=step, diameter="physical", keep=tmp_path / "library")
    answer = simulate(scene, engine)
    alone, inside = (tmp_path / at / "column.lammpstrj" for at in ("deck", "library"))
    assert filecmp.cmp(alone, inside, shallow=False)
    assert np.array_equal(read_dump(alone)[1], answer.velocity)


def test_a_deck_of_a_composition_has_a_ground(tmp_path: Path):
    scene, step = scene_on(GROUNDS["Duffing"])
    write_deck(scene, tmp_path / "deck", step=4 * step, integrator="kahan-li6")
    lmp(tmp_path / "deck", "-screen", "none")
    engine = Lammps("kahan-li6", step=4 * step, diameter="physical")
    _, v = read_dump(tmp_path / "deck" / "column.lammpstrj")
    assert np.array_equal(v, simulate(scene, engine).velocity)


def test_a_deck_of_a_composition_cannot_tell_the_time(tmp_path: Path):
    scene, step = scene_on(MATHIEU)
    with pytest.raises(InputError, match="verlet in a deck with a time-dependent ground"):
        write_deck(scene, tmp_path, step=step, integrator="kahan-li6")


@pytest.mark.slow
def test_two_ranks_give_the_bits_of_one():
    scene, step = scene_on(GROUNDS["Mathieu"])
    one, two = (simulate(scene, Lammps("verlet", step=step, ranks=ranks)) for ranks in (1, 2))
    assert two.cost.ranks == 2
    assert np.array_equal(one.displacement, two.displacement)
    assert np.array_equal(one.velocity, two.velocity)


@pytest.mark.parametrize(
    ("name", "acting", "integrator"),
    [("Mathieu", "strike", "verlet"), ("spring", "displaced", "rkn6")],
)
def test_a_resumed_run_gives_the_same_bits(
    name: str, acting: str, integrator: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    scene, step = scene_on(GROUNDS[name], acting)
    engine = Lammps(integrator, step=2 * step, diameter="gauge")
    whole = simulate(scene, engine)
    answer = stop_three_times(scene, engine, tmp_path / "run", monkeypatch)
    assert np.array_equal(answer.displacement[:], whole.displacement)
    assert np.array_equal(answer.velocity[:], whole.velocity)


@pytest.mark.parametrize("name", ["spring", "Duffing", "Mathieu"])
def test_a_deck_is_read_back_with_its_scene(name: str, tmp_path: Path):
    scene, step = scene_on(GROUNDS[name])
    write_deck(scene, tmp_path, step=step)
    with pytest.raises(InputError, match="has a formula with numbers instead of parameters"):
        read_deck(tmp_path)
    read = read_deck(tmp_path, scene)
    assert read.scene.chain == scene.chain
    assert read.step == pytest.approx(step, rel=1e-9)
    other = scene.replace(chain=scene.chain.replace(ground=Law("k*u", k=1e4)))
    with pytest.raises(InputError, match=r"write the deck again|can be predicted"):
        read_deck(tmp_path, other)
