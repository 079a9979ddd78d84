"""Misspelt names: every message contains the name that was probably meant."""

import re

import numpy as np
import pytest
from helpers.faults import faults

from lmpchain import Chain, Impulse, Impurity, InputError, Scene, disorder, simulate
from lmpchain.cli import main
from lmpchain.cli.verbs import VERBS
from lmpchain.design import sensitivities
from lmpchain.engines import Lammps, Native
from lmpchain.simulation import observables
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
        (lambda: disorder.factors(1.0, 3, np.random.default_rng(1), law="dysen"), "dyson"),
    ],
)
def test_python_suggests_names(ask, meant):
    assert f"(did you mean '{meant}'?)" in faults(ask)[0][1]


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("rnu s.toml", "run"),
        ("run s.toml --tolerence 1e-3", "--tolerance"),
        ("run s.toml --enigne=native", "--engine"),
        ("deck s.toml -o d --integrator velvet", "verlet"),
    ],
)
def test_the_command_line_suggests_names(line, meant, capsys):
    assert main(line.split()) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("error: ")
    assert f"(did you mean '{meant}'?)" in said


@pytest.mark.parametrize(
    ("section", "more"),
    [
        ("chain", {"cell", "taper", "file", "law", "damping", "grains"}),
        ("excitation", {"kind", "velocity", "grain"}),
        ("recording", {"duration", "samples", "quantities"}),
        ("chain.impurity]", {"grain", "mass"}),
    ],
)
def test_every_key_that_a_section_takes_is_listed_and_no_other(section: str, more: set[str]):
    """Each listed key is accepted by name, regardless of its value."""
    listed = said_of_keys(section, "qqqq = 1")["qqqq"].split("; the keys here are ")[1].split(", ")
    assert more <= set(listed)
    for key in listed:
        if f"\n{key} =" not in TEXT and key != "impurity":
            assert "unknown key" not in said_of_keys(section, f"{key} = {{}}").get(key, ""), key


def said_of_keys(section: str, line: str) -> dict[str, str]:
    """Return the faults of a scene with an additional line, by the last name of their keys."""
    text = TEXT.replace(f"[{section}]", f"[{section}]\n{line}")
    try:
        Scene.from_text(text)
    except InputError as error:
        return {key.split(".")[-1]: message for key, message in error.faults}
    return {}


def test_the_keys_of_a_trace_from_a_file_are_listed():
    text = TEXT.replace('"impulse"', '"drive"').replace("velocity =", "qqqq =")
    with pytest.raises(InputError, match=r"the keys here are kind, .*file.*columns"):
        Scene.from_text(text)


def help_of(verb: str, option: str) -> str:
    (text,) = (options["help"] for spelled, options in VERBS[verb].arguments if option in spelled)
    return text


@pytest.mark.parametrize(
    ("verb", "option", "owned"),
    [
        (
            "averages",
            "--of",
            {*observables.OF_CHAIN, *observables.OF_GRAIN, *observables.OF_CONTACT},
        ),
        ("sensitivity", "--answer", set(sensitivities.UNITS)),
        ("run", "--integrator", {*Native.integrators, *Lammps.integrators}),
    ],
)
def test_the_help_lists_what_is_accepted(verb: str, option: str, owned: set[str]):
    """The help lists the names as text, because importing their modules is slow."""
    words = set(re.findall(r"[a-z][a-z0-9_-]+", help_of(verb, option)))
    assert owned
    assert owned <= words
