"""Sensitivities against scaling laws that hold exactly, and against random chains."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of

from lmpchain import Impulse, InputError, Profile, simulate
from lmpchain.cli import main
from lmpchain.design import KineticEnergy, PeakForce, gradient, sensitivity
from lmpchain.design.parameters import changed, values

VACUUM = scene_of(column(12, gravity=0.0, bottom="wall"), Impulse(velocity=0.1), 6e-5, 31)


DAMPED = VACUUM.replace(chain=VACUUM.chain.replace(damping={"viscoelastic": 3e-7, "drag": 5e3}))


def test_a_vacuum_chain_scales_with_its_modulus_and_strike():
    """Forces scale as E^(2/5) v^(6/5) at sufficiently long times, for any chain."""
    found = sensitivity(VACUUM, "peak_force:6")
    assert found.relative["youngs_modulus"].sum() == pytest.approx(0.4 * found.value, rel=1e-3)
    assert found.relative["velocity"].sum() == pytest.approx(1.2 * found.value, rel=1e-3)
    assert "gravity" not in found.relative
    ranked = found.ranked()
    assert ranked[0][0] == "diameters 1"
    assert abs(ranked[0][1]) >= abs(ranked[-1][1])


def test_damping_scales_with_the_time_that_a_collision_takes():
    """A and 1 / gamma scale as the collision time E^(-2/5) v^(-1/5)."""
    found = sensitivity(DAMPED, "peak_force:3", tolerance=1e-3)
    by_time = float(found.relative["damping.viscoelastic"][0] - found.relative["damping.drag"][0])
    assert abs(by_time) > 1e-3 * found.value
    for name, power, share in (("youngs_modulus", 0.4, 0.4), ("velocity", 1.2, 0.2)):
        scaled = power * found.value + share * by_time
        assert found.relative[name].sum() == pytest.approx(scaled, rel=1e-4), name
    assert "damping.drag" in found.table()


@pytest.mark.slow
def test_uncertain_damping_scatters_a_result():
    found = sensitivity(DAMPED, "peak_force:3", {"damping.viscoelastic": 0.1, "damping.drag": 0.1})
    shares = [float(0.1 * found.relative[name][0]) for name in found.uncertainty]
    assert found.deviation == pytest.approx(np.hypot(*shares), rel=1e-12)
    assert found.scatter == pytest.approx(found.deviation, rel=0.1)


@pytest.mark.slow
def test_an_uncertainty_is_the_scatter_of_random_chains(rng):
    share = 1e-4
    found = sensitivity(VACUUM, "peak_force:6", {"diameters": share, "youngs_modulus": share})
    answers = []
    for _ in range(100):
        other = {
            name: values(VACUUM, name) * (1 + share * rng.standard_normal(12))
            for name in ("diameters", "youngs_modulus")
        }
        answers.append(gradient(changed(VACUUM, other), PeakForce(6), ["masses"], 1e-4).value)
    assert np.std(answers) == pytest.approx(found.deviation, rel=0.15)


@pytest.mark.slow
def test_the_command_ranks_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    simulate(DAMPED.replace(duration=3e-5), tolerance=1e-6).save(tmp_path / "run.nc")
    picture = tmp_path / "along.png"
    numbers = tmp_path / "numbers.json"
    wanted = ["sensitivity", str(tmp_path / "run.nc"), "--answer", "energy:3-9"]
    uncertain = ["--sigma-diameter", "0.01", "--sigma-viscoelastic", "0.1", "--sigma-drag", "0.1"]
    assert main([*wanted, *uncertain, "-o", str(picture), "--json", str(numbers)]) == 0
    said = capsys.readouterr().out
    assert "energy:3-9" in said
    for name in ("diameters", "damping.viscoelastic", "damping.drag"):
        assert f"by the uncertainty of {name}" in said
    assert "to first order" in said
    assert "by 32 random chains" in said
    assert picture.stat().st_size > 1000
    kept = json.loads(numbers.read_text())
    assert len(kept["derivatives"]["diameters"]) == 12


@pytest.mark.parametrize(
    ("of", "text"),
    [
        ("peak_force", "peak_force:CONTACT"), ("peek_force:3", "peak_force"),
        ("momentum:9-3", "FIRST-LAST"),
        ("peak_force:99", "12"),
    ],
)  # fmt: skip
def test_an_unknown_objective_is_named(of: str, text: str):
    with pytest.raises(InputError, match=text):
        sensitivity(VACUUM, of)


def test_given_masses_replace_diameters():
    chain = column(4, masses=np.full(4, 1e-6), contact_constants=np.full(3, 1e9), top_load=0.1)
    scene = scene_of(chain, Profile(velocity=[1e-3, 0, 0, 0]), 1e-5, 3)
    found = sensitivity(scene, KineticEnergy([2]), {"masses": 0.01})
    assert set(found.relative) == {"masses", "contact_constants", "top_load", "gravity", "velocity"}
    with pytest.raises(InputError, match="uncertain"):
        sensitivity(scene, KineticEnergy([2]), {"diameters": 0.01})
