"""Valid but implausible input causes one warning line: wrong units, or excessive strikes."""

import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.faults import remarks

from lmpchain import GLASS, Impurity, Profile, plan, simulate
from lmpchain.cli import main

CHAIN = column(5)
SPRINGS = column(3, gravity=0.0, exponent=1.0, top_load=1e-3, masses=[1e-20] * 3)


def test_the_sound_speed_is_that_of_the_grain_material():
    slow = {"density": 1e4, "youngs_modulus": 1e4, "poissons_ratio": 0.2}  # 1 m/s.
    assert GLASS.sound_speed == pytest.approx(5055, abs=1)
    odd = SPRINGS.replace(impurity=[Impurity(grain=2, mass=1e-20)])
    soft = column(4, gravity=0.0, material=["glass", "glass", slow, "glass"], bottom="free")
    for chain, speeds, grains in (
        (odd, [0, 2.0, 0], 0),
        (soft, [2.0] * 4, 1),
        (soft, [0.5] * 4, 0),
    ):
        texts = remarks(lambda c=chain, v=speeds: scene_of(c, Profile(velocity=v), 1e-6))
        assert sum("grain 3 moves at 2 m/s, faster than sound" in text for text in texts) == grains


def test_usual_values_cause_no_warning():
    assert not remarks(lambda: struck(column(120), 8.57e-3, 1.0))
    assert not remarks(lambda: struck(column(120, exponent=1.0, top_load=1e-2), 1e-3, 1e-5))


def test_the_warning_is_given_once():
    def work():
        scene = struck(CHAIN, 20.0, 1e-5)
        plan(scene)
        simulate(scene, "native")

    (text,) = remarks(work)
    assert text.startswith("velocity: a contact is compressed by 0.012 of the diameter")
    assert "\n" not in text


def test_the_command_line_warns_once(tmp_path, capsys):
    struck(CHAIN, 1e-3, 1e-5).to_toml(tmp_path / "s.toml")
    text = (tmp_path / "s.toml").read_text().replace("0.001", "0.5", 1)
    (tmp_path / "s.toml").write_text(text)
    assert main(["run", str(tmp_path / "s.toml"), "-o", str(tmp_path / "s.nc")]) == 0
    assert capsys.readouterr().err.splitlines() == [
        "warning: diameter: 0.5 m is wide for a grain; diameters are in metres (1 mm is 1e-3)"
    ]


@pytest.mark.parametrize(("turn", "number"), [(9.9, 0), (10.1, 1)])
def test_contacts_that_are_rigid_dashpots_cause_a_warning(turn: float, number: int):
    frequency = struck(CHAIN, 1e-3, 1e-5).fastest_motion
    damped = CHAIN.replace(damping={"viscoelastic": turn / frequency})
    texts = remarks(lambda: struck(damped, 1e-3, 1e-5))
    rigid = f"A omega is {turn:.2g}, so that contacts act as rigid dashpots"
    assert sum(rigid in text for text in texts) == number
