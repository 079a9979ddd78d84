"""Misspelt names: every message says which name was probably meant."""

import pytest

from lmpchain import Chain, Impulse, Impurity, InputError, Scene, disorder, simulate
from lmpchain.cli import main
from lmpchain.sweeps.file import read_sweep

SCENE = Scene(
    chain=Chain(grains=3, diameter=1e-3), excitation=Impulse(velocity=1e-3), duration=1e-6
)
TEXT = """
[chain]
grains = 3
diameter = 1e-3
[[chain.impurity]]
grain = 2
mass = 1e-6
[excitation]
kind = "impulse"
velocity = 1e-3
[recording]
duration = 1e-6
"""


def swept(**keys):
    return lambda: read_sweep({"scene": SCENE, "grid": {"chain.gravity": [1.0]}} | keys)


@pytest.mark.parametrize(
    ("ask", "meant"),
    [
        *[
            (
                lambda name=name: Scene.from_text(TEXT.replace(name, name[1] + name[0] + name[2:])),
                name,
            )
            for name in (
                "chain",
                "grains",
                "diameter",
                "impurity",
                "mass",
                "excitation",
                "kind",
                "recording",
                "duration",
            )
            if TEXT.count(name) == 1 or name in ("impurity", "mass")
        ],
        (lambda: Scene.from_text(TEXT.replace("impulse", "inpulse")), "impulse"),
        (lambda: Chain(grains=3, diameter=1e-3, material="glas"), "glass"),
        (lambda: Chain(grains=3, diameter=1e-3, material="STEELE"), "steel"),
        (lambda: Chain(grains=3, diameter=1e-3, top="fre"), "free"),
        (lambda: Impurity(grian=3, mass=1e-6), "grain"),
        (lambda: simulate(SCENE, "nativ"), "native"),
        (lambda: simulate(SCENE, "lamps"), "lammps"),
        (lambda: simulate(SCENE, "native", integrater="verlet"), "integrator"),
        (lambda: simulate(SCENE, "native", integrator="velvet"), "verlet"),
        (lambda: simulate(SCENE, "native", force="exakt"), "exact"),
        (lambda: simulate(SCENE, "lammps", diameter="guage"), "gauge"),
        (swept(keep=["velocty"]), "velocity"),
        (swept(tolerence=1e-3), "tolerance"),
        (swept(grid={"chian.gravity": [1.0]}), "chain"),
        (swept(engine="nativ"), "native"),
        (swept(scene={"chian": {}}), "chain"),
        (lambda: disorder.factors(1.0, 3, None, law="dysen"), "dyson"),
    ],
)
def test_python_guesses_what_was_meant(ask, meant):
    with pytest.raises(InputError) as caught:
        ask()
    assert f"(did you mean '{meant}'?)" in caught.value.faults[0][1]


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("rnu s.toml", "run"),
        ("run s.toml --tolerence 1e-3", "--tolerance"),
        ("run s.toml --enigne=native", "--engine"),
        ("deck s.toml -o d --integrator velvet", "verlet"),
    ],
)
def test_the_command_line_guesses_what_was_meant(line, meant, capsys):
    assert main(line.split()) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("error: ")
    assert f"(did you mean '{meant}'?)" in said


def test_nothing_is_guessed_where_nothing_is_near():
    with pytest.raises(InputError) as caught:
        Chain(grains=3, diameter=1e-3, material="wood")
    assert "did you mean" not in str(caught.value)
