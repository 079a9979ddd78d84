"""Packets travel down at the group velocity, and are scattered as in theory."""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from numpy.typing import NDArray

from lmpchain import Chain, Law, Packet, Profile, Scene, simulate
from lmpchain.measure import energy

Array = NDArray[np.float64]
WALLS = {"top": "wall", "bottom": "wall"}


def uniform(grains: int = 400, **keys: Any) -> Chain:
    return column(grains, **WALLS | {"gravity": 0.0, "top_load": 1.0, "exponent": 1.0} | keys)


def packet_at(grain: int, omega: float, width: float, amplitude: float) -> Packet:
    return Packet(frequency=omega / (2 * np.pi), width=width, grain=grain, amplitude=amplitude)


def middle(t, part: slice = slice(None)) -> Array:
    """Return the mean position of the energy over time, in grains."""
    found = energy.shares(t)
    weight = found.of_grain[:, part]
    return (weight * found.grain[part]).sum(1) / weight.sum(1)


@pytest.mark.parametrize("q", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("engine", ["modes", "native"])
def test_a_packet_travels_with_the_group_velocity(q: float, engine: str):
    """The speed sqrt(k/m) cos(q/2) of w = 2 sqrt(k/m) sin(q/2) is averaged over the band."""
    chain = uniform()
    omega = 2 / chain.time_scale * np.sin(q / 2)
    width = 20.0
    packet = packet_at(140, omega, width, 1e-6 * chain.length_scale)
    speed = np.cos(q / 2) / chain.time_scale
    scene = Scene(chain=chain, excitation=packet, duration=100 / speed, samples=11)
    place = middle(simulate(scene, engine, 1e-9))
    # The energy is distributed over wave numbers as exp(-(width dq)^2), which reduces the mean of
    # cos by exp(-1 / (16 width^2)).
    expected = place[0] + speed * scene.time * np.exp(-1 / (16 * width**2))
    assert place == pytest.approx(expected, rel=0, abs=2e-3)


@pytest.mark.parametrize(("q", "width"), [(0.3, 25.0), (1.0, 20.0), (2.0, 8.0), (2.9, 25.0)])
def test_velocities_and_strains_are_samples_of_one_wave(q: float, width: float):
    """At grains v = A w exp(-x^2 / 2 width^2) cos(q x), and 2 A sin(q/2) times this between them.

    The displacement that follows has the spectrum of the strain over 2 sin(k/2): A is the height of
    its envelope.
    """
    chain = uniform(460)
    omega = 2 / chain.time_scale * np.sin(q / 2)
    amplitude = 1e-6 * chain.length_scale
    packet = packet_at(230, omega, width, amplitude)
    u, v = packet.initial(chain)
    x = np.arange(1, 461) - 230.0
    near = np.abs(x) < 8.9 * width

    def wave(place: Array) -> Array:
        return np.exp(-(place**2) / (2 * width**2)) * np.cos(q * place)

    assert v[near] == pytest.approx(
        amplitude * omega * wave(x)[near], rel=0, abs=1e-11 * amplitude * omega
    )
    strain = 2 * amplitude * np.sin(q / 2) * wave(x[:-1] + 0.5)
    between = near[:-1] & near[1:]
    assert (u[:-1] - u[1:])[between] == pytest.approx(strain[between], rel=0, abs=1e-11 * amplitude)
    k = np.linspace(-12, 12, 4000) / width + q
    weight = np.exp(-((width * (k - q)) ** 2) / 2)
    shape = -(np.sin(np.outer(x, k)) * weight * np.sin(q / 2) / np.sin(k / 2)).sum(1) / weight.sum()
    assert u == pytest.approx(amplitude * shape, rel=0, abs=1e-9 * amplitude)
    assert not v[~(np.abs(x) <= 9 * width)].any()
    assert not u[~(np.abs(x) <= 9 * width)].any()


def test_a_short_packet_moves_no_grain_beyond_its_ends() -> None:
    """The strains of one wave have a sum, which is subtracted in the shape of the envelope."""
    q, width = 0.3, 4.0
    chain = uniform(460)
    amplitude = 1e-6 * chain.length_scale
    packet = packet_at(230, 2 / chain.time_scale * np.sin(q / 2), width, amplitude)
    u, _ = packet.initial(chain)
    x = np.arange(230 - 36, 230 + 36) + 0.5 - 230.0
    envelope = np.exp(-(x**2) / (2 * width**2))
    wave = envelope * np.cos(q * x)
    mean = wave.sum() / envelope.sum()
    assert mean > 0.4
    strain = 2 * amplitude * np.sin(q / 2) * (wave - mean * envelope)
    assert -np.diff(u[193:266]) == pytest.approx(strain, rel=0, abs=1e-11 * amplitude)
    assert np.abs(u[:194]).max() < 1e-12 * amplitude
    assert not u[265:].any()


@pytest.mark.parametrize(("width", "most"), [(4.0, 3e-3), (8.0, 1e-9), (12.0, 1e-14)])
def test_the_upward_part_is_negligible(width: float, most: float):
    """The upward part is the tail of exp(-(q width)^2 / 2) beyond q = 1."""
    chain = uniform(500)
    omega = 2 / chain.time_scale * np.sin(0.5)
    packet = packet_at(200, omega, width, 1e-6 * chain.length_scale)
    scene = Scene(chain=chain, excitation=packet, duration=150 * chain.time_scale, samples=2)
    found = energy.shares(simulate(scene, "modes"))
    up = found.part(1, 170)[-1] / found.part(1, 500)[-1]
    assert up < most
    # Without its velocity, half of the packet travels upward.
    rest = Profile(displacement=packet.initial(chain)[0])
    still = energy.shares(simulate(Scene(**scene.given() | {"excitation": rest}), "modes"))
    assert still.part(1, 200)[-1] / still.part(1, 500)[-1] == pytest.approx(0.5, abs=0.02)


def test_a_packet_under_gravity():
    """The upward part is small for local wave numbers, and the arrival follows the travel time."""
    chain = Chain(grains=900, diameter=1e-3, bottom="wall")
    omega = 0.8 * np.sqrt(chain.linear_stiffness[300] / chain.masses[0])
    packet = packet_at(300, omega, 20.0, 1e-7 * chain.length_scale)
    local = np.sqrt(chain.linear_stiffness[299:] / chain.masses[0])
    group = local * np.sqrt(1 - (omega / (2 * local)) ** 2)
    late = np.cumsum(1 / group)
    scene = Scene(chain=chain, excitation=packet, duration=float(late[300]), samples=2)
    t = simulate(scene, "chebyshev", 1e-3)
    found = energy.shares(t)
    assert found.part(1, 300)[-1] / found.part(1, 900)[-1] < 1e-7
    assert middle(t)[-1] == pytest.approx(600, abs=2)


def test_energy_flows_evenly_through_an_uneven_chain():
    """The product of m v^2 and the group velocity is constant along the packet."""
    x = np.linspace(-1, 1, 400)
    masses = 1e-6 * np.exp(0.5 * x)
    constants = 1e3 * np.exp(-0.8 * (x[:-1] + x[1:]) / 2)
    chain = uniform(masses=masses, contact_constants=constants, top_load=1e-2)
    omega = 3e4
    width = 20.0
    middle = 190
    amplitude = 1e-9
    packet = packet_at(middle, omega, width, amplitude)
    u, v = packet.initial(chain)
    place = np.linspace(1, 400, 399 * 20 + 1)
    across = (place - 200.5) / 199.5
    local = np.sqrt(1e3 * np.exp(-0.8 * across) / (1e-6 * np.exp(0.5 * across)))
    number = 2 * np.arcsin(omega / (2 * local))
    group = local * np.sqrt(1 - (omega / (2 * local)) ** 2)
    at = 20 * (middle - 1)
    phase, late = (np.append(0, np.cumsum((y[1:] + y[:-1]) / 40)) for y in (number, 1 / group))
    envelope = np.exp(-(((late - late[at]) * group[at] / width) ** 2) / 2)
    wave = envelope * np.cos(phase - phase[at]) * np.sqrt(group[at] / group)
    expected = amplitude * omega * wave[::20] * np.sqrt(masses[middle - 1] / masses)
    assert v == pytest.approx(expected, rel=0, abs=2e-3 * amplitude * omega)
    half = 20 * np.arange(399) + 10
    strain = amplitude * omega * wave[half] * np.sqrt(masses[middle - 1] / constants)
    assert u[:-1] - u[1:] == pytest.approx(strain, rel=0, abs=2e-3 * np.abs(strain).max())


def test_a_packet_that_does_not_fit_is_rejected():
    """A packet needs six widths on either side, and travelling waves everywhere."""
    chain = uniform(101)
    keys = {"frequency": 3e3, "width": 8.0, "grain": 50, "amplitude": 1e-12}
    limit = np.sqrt(chain.contacts.stiffness[40] / chain.masses[0]) / np.pi

    def faults(of: Chain = chain, **changed: float) -> list[tuple[str, str]]:
        return list(Packet(**keys | changed).faults(of, 1e-3))

    assert not faults(grain=49)
    length = "the packet extends 6 widths to either side and does not fit into the chain"
    assert faults(grain=48) == [("width", length)]
    assert not faults(grain=53)
    assert [key for key, _ in faults(grain=54)] == ["width"]
    held = uniform(101, bottom="fixed")
    assert not faults(held, grain=52)
    assert [key for key, _ in faults(held, grain=53)] == ["width"]
    assert faults(grain=102) == [("grain", "must be a grain that moves, 1 to 101 (got 102)")]
    assert faults(held, grain=101) == [("grain", "must be a grain that moves, 1 to 100 (got 101)")]
    vacuum = Chain(grains=101, diameter=1e-3, gravity=0.0)
    load = "there are no linear waves without gravity and load: give a top_load"
    assert faults(vacuum) == [("kind", load)]
    grounded = chain.replace(ground=Law("k*u", k=1e3))
    cure = "a packet does not support a force from the ground: leave it out, or give a profile"
    assert faults(grounded) == [("chain.ground", cure)]
    assert not faults(frequency=0.9999 * limit)
    heavy = uniform(101, impurity=[{"grain": 61, "mass": 2 * chain.masses[0]}])
    assert not faults(heavy, frequency=0.9999 * limit / np.sqrt(2))
    (fault,) = faults(heavy, frequency=1.0001 * limit / np.sqrt(2))
    text = f"must be below the cut-off frequency at grain 60, {limit / np.sqrt(2):.4g} Hz"
    assert fault == ("frequency", text)
    beyond = uniform(101, impurity=[{"grain": 99, "mass": 2 * chain.masses[0]}])
    assert not faults(beyond, frequency=0.99 * limit)


def test_part_and_scale():
    chain = uniform()
    packet = Packet(frequency=5e3, width=10.0, grain=200, amplitude=1e-12)
    first, last = packet.reach(chain)
    u, v = packet.initial(chain)
    assert not u[: first - 1].any()
    assert not v[last:].any()
    near, far = packet.part(50, 390).initial(chain.part(50, 390))
    assert near == pytest.approx(u[49:390], rel=1e-9, abs=1e-12 * np.abs(u).max())
    assert far == pytest.approx(v[49:390], rel=1e-9, abs=1e-12 * np.abs(v).max())
    assert packet.scaled(3.0).initial(chain)[1] == pytest.approx(3 * v, rel=1e-14)


def test_a_packet_reaches_9_widths_within_the_chain():
    chain = uniform(40)
    for grain, reached in ((13, (1, 31)), (20, (2, 38)), (28, (10, 40))):
        packet = Packet(frequency=0.1 / chain.time_scale, width=2.0, grain=grain, amplitude=1e-9)
        assert packet.reach(chain) == reached
        displacement, velocity = packet.initial(chain)
        assert displacement[reached[0] - 1] != 0 != velocity[reached[0] - 1]
