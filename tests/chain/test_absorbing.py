"""Absorbing boundaries: reflection, compared with linear systems solved as a whole."""

import numpy as np
import pytest
from helpers.thinned import thinned

import lmpchain
from lmpchain import Chain, patterns
from lmpchain.chain.contact_law import dynamical_matrix
from lmpchain.errors import InputError
from lmpchain.theory import scattering

PRESSED = {"gravity": 0.0, "top_load": 20.0, "bottom": "wall"}
UNIFORM = Chain(grains=30, diameter=1e-2, material="steel", **PRESSED)
GROUND = lmpchain.Law("k*u", k=1e6)
DIMER = patterns.periodic(41, 1e-2, ["steel", "ptfe"], **PRESSED)
TRIMER = patterns.periodic(41, 1e-2, ["steel", "ptfe", "brass"], **PRESSED)
# Contacts at a kink are stiff, but no wave is linear there.
LOOSE = UNIFORM.replace(top_load=0.0, law=lmpchain.laws.bilinear(0.3))
VISCOUS = {"viscoelastic": 0.001 / DIMER.band_edge}


def given_back(chain: Chain, before: int, cell: int, omega: float) -> float:
    """Return the reflected amplitude of a wave in the first grains of a chain.

    Forced on grain 1, all grains follow from one linear system; in one grain of every cell the wave
    is a exp(i q j) + b exp(-i q j).
    """
    diagonal, coupling = chain.dynamical_matrix()
    drag = chain.drag[: chain.movable].astype(complex)
    # The losses of the upper layer are removed, because this end is open.
    drag[:before] = 0.0
    springs = chain.contacts.stiffness * chain.contact_viscosity
    springs[: before + 1] = 0.0
    viscous, transferred = dynamical_matrix(springs, chain.masses[: chain.movable])
    coupling = coupling - 1j * omega * transferred
    matrix = np.diag(diagonal - omega**2 - 1j * omega * (drag + viscous))
    matrix += np.diag(coupling, 1) + np.diag(coupling, -1)
    force = np.zeros(chain.movable)
    force[0] = 1.0
    u = np.linalg.solve(matrix, force)[2:before:cell]
    turn = np.mean((u[2:] + u[:-2]) / (2 * u[1:-1])).real
    steps = np.arange(u.size)
    waves = np.exp(1j * np.arccos(turn) * steps)
    amplitudes, *_ = np.linalg.lstsq(np.column_stack((waves, waves.conj())), u, rcond=None)
    smaller, larger = sorted(np.abs(amplitudes))
    return float(smaller / larger)


@pytest.mark.parametrize(
    ("chain", "cell", "bottom"),
    [
        (UNIFORM, 1, "fixed"),
        (DIMER.replace(damping=VISCOUS), 2, "wall"),
        (TRIMER.replace(ground=GROUND), 3, "fixed"),
    ],
    ids=["uniform", "viscous dimer", "trimer on a ground"],
)
def test_reflection_equals_that_of_the_whole_linear_system(chain, cell, bottom):
    absorbs = patterns.absorbing(chain.replace(bottom=bottom), bottom=60)
    bands = scattering.reflection(absorbs, 60).bands
    assert len(bands) == cell
    for low, high in bands:
        for place in (0.1, 0.45, 0.9):
            omega = low + place * (high - low)
            expected = given_back(absorbs, chain.grains, cell, omega)
            amplitude = scattering.reflection(absorbs, 60, frequency=[omega]).amplitude
            assert abs(amplitude[0]) == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("chain", "grains", "amplitude"),
    [(UNIFORM, 60, 1.3e-3), (UNIFORM, 80, 1e-3), (DIMER, 60, 7.5e-3), (DIMER, 120, 1e-3)],
)
def test_reflections_are_as_small_as_documented(chain, grains, amplitude):
    absorbs = patterns.absorbing(chain, bottom=grains, top=grains)
    for end in ("bottom", "top"):
        wave = scattering.reflection(absorbs, grains, end)
        limit = amplitude if end == "bottom" else 1.5 * amplitude
        assert np.abs(wave.amplitude).max() < limit
        assert wave.reflected.max() < 1e-3


@pytest.mark.parametrize("share", thinned([0.5, 0.3], 2))
def test_transmission_of_a_driven_dimer_agrees_with_theory(share):
    leads = ["steel"] * 20
    material = [*leads, *["steel", "aluminium"] * 30, *leads]
    chain = Chain(grains=100, material=material, diameter=1e-2, **PRESSED)
    size = 80
    absorbs = patterns.absorbing(chain, bottom=size, top=size)
    stiffness = chain.linear_stiffness[0]
    omega = share * 2 * np.sqrt(stiffness / chain.masses[0])
    through = scattering.transmission(chain, [omega])
    # Amplitude of the wave that the force emits into an endless uniform chain.
    push = 1e-4
    incoming = push / (2 * stiffness * np.sin(2 * np.arcsin(share)))
    periods = 300
    scene = lmpchain.Scene(
        chain=absorbs,
        excitation=lmpchain.Force(grain=size + 6, amplitude=push, frequency=omega / (2 * np.pi)),
        duration=periods * 2 * np.pi / omega,
        samples=8 * periods + 1,
        grains=[size + 95],
    )
    answer = lmpchain.simulate(scene, engine="native", tolerance=1e-5)
    # Component at the frequency of the force, during the last hundred periods.
    late = slice(8 * (periods - 100), 8 * periods)
    window = np.hanning(801)[:-1]
    turned = window * np.exp(1j * omega * answer.time[late]) * answer.displacement[late, 0]
    amplitude = 2 * abs(turned.sum()) / window.sum() / incoming
    assert amplitude == pytest.approx(abs(through.amplitude_transmitted[0]), rel=1e-3)
    assert 0.4 < through.transmitted[0] < 0.99


def test_added_layers_continue_the_pattern_of_the_chain():
    with pytest.warns(UserWarning, match="layer of [67] grains reflects"):
        absorbs = patterns.absorbing(DIMER, bottom=7, top=6)
    names = [material.name for material in absorbs.material]
    assert names == ["steel", "ptfe"] * 27
    assert np.array_equal(absorbs.drag[6:47], np.zeros(41))
    masses = np.arange(1.0, 31.0) * 1e-3
    masses[-16:] = np.resize([1e-3, 2e-3, 3e-3], 16)
    constants = np.full(29, 1e9)
    constants[-17:] = np.resize([1e9, 2e9, 3e9], 17)
    listed = UNIFORM.replace(
        masses=masses,
        contact_constants=constants,
        damping={"viscoelastic": 1e-9, "drag": np.full(30, 2.0)},
    )
    with pytest.warns(UserWarning, match="layer of 9 grains reflects"):
        longer = patterns.absorbing(listed, bottom=9)
    assert np.array_equal(longer.masses[30:], np.resize(np.roll(masses[-3:], 0), 9))
    assert np.array_equal(longer.contact_constants[29:], np.resize(constants[-3:], 9))
    assert longer.damping.viscoelastic == 1e-9
    assert longer.drag[:30].tolist() == [2.0] * 30
    assert (np.diff(longer.drag[29:]) > 0).all()
    odd = UNIFORM.replace(impurity=[{"grain": 15, "diameter": 2e-2}])
    assert patterns.absorbing(odd, bottom=60, top=60).impurity[0].grain == 75


def test_listed_parameters_of_laws_continue() -> None:
    """Alternating springs and grounds are continued like the contact constants of such a chain."""
    stiff = np.resize([1e6, 3e6], 29)
    ground = np.resize([2e5, 1e5], 30)
    fields = {**PRESSED, "grains": 30, "diameter": 1e-2}
    chain = Chain(**fields, law=lmpchain.Law("k*o*c", k=1e6, c=stiff / 1e6), ground=GROUND)
    longer = patterns.absorbing(chain.replace(ground=GROUND.replace(k=ground)), bottom=90, top=90)
    assert longer.linear_stiffness == pytest.approx(np.resize([1e6, 3e6], 209), rel=1e-13)
    assert longer.ground_stiffness.tolist() == np.resize([2e5, 1e5], 210).tolist()
    linear = Chain(**fields, exponent=1.0, contact_constants=stiff, ground=GROUND)
    expected = patterns.absorbing(linear, bottom=90)
    # The wall constants differ, and the end of the layer hardly matters.
    found = patterns.absorbing(chain, bottom=90)
    assert found.drag == pytest.approx(expected.drag, rel=0.05)


def test_a_layer_at_the_top_is_the_mirror_image_of_one_at_the_bottom() -> None:
    """Three kinds of grains, contacts and grounds, between two walls."""
    lists = {
        "material": np.resize(["steel", "ptfe", "brass"], 41),
        "viscoelastic": np.resize([1e-9, 3e-9, 2e-9], 40),
        "k": np.resize([2e5, 1e5, 4e5], 41),
    }
    layers = []
    for sign, size in ((1, {"top": 60, "bottom": 0}), (-1, {"bottom": 60})):
        material, viscoelastic, k = (values[::sign].tolist() for values in lists.values())
        chain = Chain(
            grains=41, diameter=1e-2, material=material, **PRESSED | {"top": "wall"},
            damping={"viscoelastic": viscoelastic}, ground=GROUND.replace(k=k),
        )  # fmt: skip
        absorbs = patterns.absorbing(chain, **size)
        wave = scattering.reflection(absorbs, 60, "top" if sign > 0 else "bottom")
        layers.append([*absorbs.drag[::sign], *np.abs(wave.amplitude)])
    assert layers[0] == pytest.approx(layers[1], rel=1e-6)


def test_a_short_layer_states_its_reflection_and_has_the_drag_of_a_power():
    with pytest.warns(UserWarning, match="absorbing layer of 12 grains") as told:
        absorbs = patterns.absorbing(DIMER, bottom=12)
    low, high = scattering.reflection(absorbs, 12).bands.T[:, :, None]
    middle = (low + np.linspace(0.1, 0.9, 61) * (high - low)).ravel()
    wave = scattering.reflection(absorbs, 12, frequency=middle)
    worst = 100 * np.abs(wave.amplitude).max() ** 2
    assert f"reflects {worst:.2g} % of the energy" in str(told[0].message)
    assert told[0].filename == __file__
    # The drag of each grain is that at its centre.
    depth = (np.arange(12) + 0.5) / 12
    power = np.diff(np.log(absorbs.drag[-12:])) / np.diff(np.log(depth))
    assert power == pytest.approx(round(power[0]), rel=1e-10)
    assert round(power[0]) in (2, 3, 4)


def test_a_column_under_gravity_absorbs_at_its_bottom():
    column = Chain(grains=100, diameter=1e-3)
    absorbs = patterns.absorbing(column, bottom=100)
    assert absorbs.equilibrium_force[:98] == pytest.approx(column.equilibrium_force[:98])
    assert scattering.reflection(absorbs, 100).reflected.max() < 1e-4
    with pytest.raises(InputError, match="would load the chain by its weight"):
        patterns.absorbing(column, top=60)


def test_a_striker_stays_on_its_side_of_the_chain():
    striker = UNIFORM.replace(load_grain=2)
    absorbs = patterns.absorbing(striker, bottom=60)
    assert absorbs.load_grain == 2
    with pytest.raises(InputError, match="would not be pressed"):
        patterns.absorbing(striker, top=60)


@pytest.mark.parametrize(
    ("chain", "sizes", "message"),
    [
        (UNIFORM, {"bottom": 0}, "must be positive if top is 0"),
        (UNIFORM, {"bottom": 2.5}, "whole number of grains"),
        (UNIFORM, {"bottom": -1}, "whole number of grains"),
        (DIMER, {"bottom": 5}, "three cells or more, 6 grains"),
        (UNIFORM.replace(top_load=0.0), {}, "carry no force at rest"),
        (LOOSE, {}, "carry no force at rest"),
    ],
)
def test_unsuitable_chains_are_rejected(chain, sizes, message):
    with pytest.raises(InputError, match=message):
        patterns.absorbing(chain, **sizes)


def test_reflection_of_a_short_end_or_outside_the_bands_is_rejected():
    absorbs = patterns.absorbing(UNIFORM, bottom=60)
    for options, message in (
        ({"grains": 2}, "three cells"),
        ({"end": "left"}, "bottom"),
        ({"frequency": [1e9]}, "within a band"),
    ):
        with pytest.raises(InputError, match=message):
            scattering.reflection(absorbs, **options)
    with pytest.raises(InputError, match="carry no force at rest"):
        scattering.reflection(LOOSE, 20)
