"""Dependence of a motion's inputs on a scene's properties, against differences of new scenes."""

from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of

from lmpchain import Chain, Drive, Force, Impulse, InputError, Profile, Scene
from lmpchain.design import parameters
from lmpchain.design.parameters import changed
from lmpchain.integrators.adjoint import Inputs

N = 5
DIAMETERS = 1e-3 * np.array([1.0, 1.3, 0.9, 1.1, 1.2])
KNOTS = np.linspace(0, 1e-5, 5)
PLAIN: dict[str, Any] = {
    "grains": N,
    "diameter": DIAMETERS,
    "top_load": 0.2,
    "exponent": 1.7,
    "top": "wall",
    "bottom": "wall",
}
MIXED = ["glass", "steel", "brass", "glass", "steel"]
CHAINS = {
    "walls of their grains": PLAIN | {"material": MIXED},
    "walls of steel": PLAIN
    | {"top_material": "steel", "bottom_material": "brass", "exponent": 1.5},
    "one wall of steel": PLAIN | {"bottom_material": "steel", "top": "free"},
    "no walls": PLAIN | {"top": "free", "bottom": "fixed"},
    "a wall above": PLAIN | {"bottom": "fixed"},
    "a wall below": PLAIN | {"top": "free"},
    "given masses": PLAIN | {"masses": 1e-6 * np.arange(1.0, 6.0)},
    "given constants": PLAIN | {"contact_constants": 1e9 * np.arange(1.0, 5.0)},
    "given walls": PLAIN | {"wall_constants": (1e9, 3e9)},
    "given both": PLAIN
    | {"wall_constants": (1e9, 3e9), "contact_constants": 1e9 * np.arange(1.0, 5.0)},
    "no weight": PLAIN | {"top": "free", "gravity": 0.0},
    "damped": PLAIN | {"damping": {"viscoelastic": 1e-7, "drag": 1e3}},
    "damped each": PLAIN
    | {"damping": {"viscoelastic": 1e-7 * np.arange(1.0, 5.0), "drag": 1e3 * np.arange(1.0, 6.0)}},
}
REST = np.array([0.0, 1.0, 2.0, 3.0, 0.0])
ACTING = {
    "strike": Impulse(velocity=1e-3),
    "profile": Profile(displacement=1e-9 * REST, velocity=1e-3 * REST),
    "sine": Drive(amplitude=1e-8, frequency=1e5),
    "points": Drive(times=KNOTS, displacement=1e-8 * np.arange(5.0) ** 2, interpolation="spline"),
    "force": Force(grain=2, times=KNOTS, force=1e-3 * np.arange(5.0), interpolation="linear"),
    "sine force": Force(grain=2, amplitude=1e-3, frequency=1e5),
}


def scene(chain: str = "no walls", acting: str = "strike") -> Scene:
    return Scene(chain=Chain(**CHAINS[chain]), excitation=ACTING[acting], duration=1e-5, samples=3)


def check_dependence(made: Scene, name: str) -> None:
    """Compare `push` with central differences of the inputs, and `pull` with its transpose."""
    base = parameters.values(made, name).astype(float)
    rng = np.random.default_rng(base.size)
    directions = np.abs(base).max() * rng.uniform(-1, 1, (2, base.size))
    if name in ("displacement", "velocity", "drive"):
        directions[:, 0] = 0  # Grain 1 or time 0 may be fixed.
    if name in ("displacement", "velocity") and made.chain.bottom == "fixed":
        directions[:, -1] = 0
    if name == "wall_constants":
        directions *= base != 0
    pushed = parameters.push(made, name, directions)
    for number, direction in enumerate(directions):
        sides = [changed(made, {name: base + side * 1e-5 * direction}) for side in (1, -1)]
        ends = [parameters.inputs(side) for side in sides]
        for field, up, down, slope in zip(Inputs._fields, *ends, pushed, strict=True):
            difference = (up - down) / 2e-5
            if field in ("displacement", "velocity") and made.excitation.kind == "drive":
                difference[0] = 0.0  # The motion of the driven grain is given by the drive.
            size = np.abs(up).max(initial=0.0) * np.abs(direction).max() / np.abs(base).max()
            assert slope[number] == pytest.approx(difference, rel=1e-6, abs=1e-7 * size), (
                name,
                field,
            )
    slopes = Inputs(
        *(rng.normal(size=row.shape[1:]) / (np.abs(row).max(initial=0.0) or 1.0) for row in pushed)
    )
    loose = slopes._replace(forces=np.where(made.chain.contacts.pressed, slopes.forces, 0.0))
    back = parameters.pull(made, loose, name)
    if name == "wall_constants":
        assert (back[base == 0] == 0).all()
    forward = [
        sum(float(s @ row[number]) for s, row in zip(loose, pushed, strict=True))
        for number in (0, 1)
    ]
    assert directions @ back == pytest.approx(
        np.array(forward), rel=1e-9, abs=1e-10 * np.abs(forward).max()
    )


@pytest.mark.parametrize("chain", CHAINS)
def test_inputs_depend_on_all_properties_of_a_chain(chain: str):
    made = scene(chain)
    names = {
        "masses",
        "contact_constants",
        "wall_constants",
        "diameters",
        "youngs_modulus",
        "top_load",
        "gravity",
    }
    if not made.chain.wall_constants.any() or made.chain.top_material or made.chain.bottom_material:
        names.remove("wall_constants")
    if made.chain.gravity == 0:
        names.remove("gravity")
    if made.chain.damped:
        names |= {"damping.viscoelastic", "damping.drag"}
    for name in sorted(names):
        check_dependence(made, name)


@pytest.mark.parametrize(
    ("acting", "names"),
    [
        ("profile", ["displacement", "velocity"]), ("sine", ["amplitude", "frequency"]),
        ("points", ["drive"]),
        ("force", ["force"]), ("sine force", ["amplitude", "frequency"]),
    ],
)  # fmt: skip
def test_inputs_depend_on_the_forcing(acting: str, names: list[str]):
    for name in names:
        check_dependence(scene(acting=acting), name)


def test_inputs_are_masses_constants_and_forces_at_rest():
    made = scene("walls of their grains", "profile")
    chain = made.chain
    inputs = parameters.inputs(made)
    weight = 9.81 * np.concatenate(([0.0], np.cumsum(chain.masses)))
    np.testing.assert_allclose(inputs.forces, 0.2 + weight, rtol=1e-12)
    np.testing.assert_array_equal(inputs.masses, chain.masses)
    np.testing.assert_array_equal(inputs.constants[1:-1], chain.contact_constants)
    np.testing.assert_array_equal(inputs.constants[[0, -1]], chain.wall_constants)
    np.testing.assert_array_equal([inputs.displacement, inputs.velocity], made.initial())
    assert inputs.drive.size == 0
    for acting, drive in (
        ("sine", [1e-8, 1e5]), ("points", 1e-8 * np.arange(5.0) ** 2),
        ("force", 1e-3 * np.arange(5.0)),
        ("sine force", [1e-3, 1e5]),
    ):  # fmt: skip
        np.testing.assert_array_equal(parameters.inputs(scene(acting=acting)).drive, drive)
    burst = Force(grain=1, shape="half-sine", amplitude=0.1, duration=7e-6)
    half = made.replace(excitation=burst, chain=scene().chain)
    assert parameters.inputs(half).drive.tolist() == [0.1, 0.0]


def test_a_mass_of_an_impurity_does_not_follow_its_diameter():
    plain = PLAIN | {"diameter": 1e-3, "top": "free", "bottom": "fixed"}
    odd = Chain(**plain, impurity=[{"grain": 2, "mass": 3e-6}, {"grain": 4, "diameter": 1.2e-3}])
    made = scene().replace(chain=odd)
    moved = parameters.push(made, "diameters", np.eye(N)).masses
    follow = np.array([1.0, 0.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(moved, np.diag(follow * 3 * odd.masses / odd.diameters), rtol=1e-12)
    with pytest.raises(InputError, match=r"^impurity: give every grain its own"):
        changed(made, {"diameters": odd.diameters})
    assert changed(made, {"gravity": np.array([1.0])}).chain.gravity == 1.0


@pytest.mark.parametrize(
    ("name", "change", "acting", "message"),
    [
        (
            "top_load",
            {"top_load": 0.0, "gravity": 0.0, "bottom": "wall"},
            "strike",
            "has no derivative in a chain",
        ),
        (
            "gravity",
            {"top_load": 0.0, "gravity": 0.0, "bottom": "wall"},
            "strike",
            "has no derivative in a chain",
        ),
        ("top_load", {"top_load": 0.0, "top": "wall"}, "strike", "has no derivative at 0"),
        ("wall_constants", {}, "strike", "there is no wall"),
        ("amplitude", {}, "strike", "needs a drive or force that is a sine"),
        ("frequency", {}, "points", "needs a drive or force that is a sine"),
        ("amplitude", {}, "force", "needs a drive or force that is a sine"),
        ("drive", {}, "strike", "needs a drive that is given by points"),
        ("drive", {}, "sine", "needs a drive that is given by points"),
        ("drive", {}, "force", "needs a drive that is given by points"),
        ("force", {}, "points", "needs a force that is given by points"),
        ("force", {}, "sine force", "needs a force that is given by points"),
    ],
)
def test_missing_properties_have_no_derivative(
    name: str, change: dict[str, Any], acting: str, message: str
):
    made = scene_of(scene().chain.replace(**change), ACTING[acting], 1e-5, 3)
    with pytest.raises(InputError) as error:
        parameters.check(made, [name])
    assert str(error.value).startswith(f"{name}: {message}")


def test_names_are_checked_at_once():
    one = scene_of(Chain(grains=1, diameter=1e-3, bottom="wall"), ACTING["strike"], 1e-6)
    with pytest.raises(InputError, match=r"^contact_constants: there is no contact between grains"):
        parameters.check(one, ["contact_constants"])
    assert parameters.check(one, "wall_constants") == ("wall_constants",)
    assert parameters.check(scene("walls of steel"), ["top_load", "gravity"]) == (
        "top_load",
        "gravity",
    )
    with pytest.raises(InputError) as error:
        parameters.check(scene(), ["colour", "amplitude"])
    assert str(error.value).startswith("parameters: ")
    assert "amplitude: needs a drive or force" in str(error.value)
    with pytest.raises(
        InputError, match=r"^parameters: name one or more of masses, contact_constants"
    ):
        parameters.check(scene(), [])
