"""Bounds on the motion between samples: closed forms of one spring, and local energies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, struck

from lmpchain import Chain, Drive, Impulse, InputError, Law, engines, simulate
from lmpchain.measure.motion import Motion, motion_of

SPRING = column(2, exponent=1.0, top_load=1.0, gravity=3.0)
OMEGA = float(np.sqrt(SPRING.linear_stiffness[0] / SPRING.masses[0]))
SPEED = 1e-6
STRIKE = Impulse(velocity=1e-4)
SOFTENS = Law("k*(o*exp(-(o/L)**2) + 0.02*o)", k=1e5, L=1e-6)


def swing(
    samples: int, angle: float, error: float = 1e-4, equation: int = 1, grains: Any = "all"
) -> Motion:
    """Return grain 1 on its spring, v cos(omega t), with the sampling phase `angle`."""
    scene = scene_of(SPRING, Impulse(velocity=SPEED), angle / OMEGA, samples, grains=grains)
    phase = OMEGA * scene.time
    u = SPEED / OMEGA * np.sin(phase)
    v = SPEED * np.cos(phase)
    recorded = np.arange(1, 3) if grains == "all" else np.array(grains)
    still = np.zeros(samples)
    columns = {1: (u, v), 2: (still, still)}
    return Motion(
        scene,
        equation,
        recorded,
        *(np.stack([columns[n][k] for n in recorded], 1) for k in (0, 1)),
        error,
    )


def test_reference_values_of_relative_errors():
    """The motion exceeds its samples by at most 1 / cos(omega h / 2); else energy limits it."""
    angle = 2.5  # The frequency is known to be at most 2^(1/2) omega.
    fine = swing(6, angle)
    more = 1 / math.cos(math.sqrt(2) * angle / 5 / 2)
    phase = np.linspace(0, angle, 6)
    assert fine.known_error("velocity") == pytest.approx(1e-4 * more * SPEED, rel=1e-12)
    largest = np.abs(np.sin(phase)).max() * SPEED / OMEGA
    assert fine.known_error("displacement") == pytest.approx(1e-4 * more * largest, rel=1e-12)
    coarse = swing(2, 2.0)
    assert coarse.known_error("velocity") == pytest.approx(1e-4 * SPEED, rel=1e-12)
    assert coarse.known_error("displacement") == pytest.approx(1e-4 * SPEED / OMEGA, rel=1e-9)
    unknown = swing(2, 2.0, equation=0)
    assert unknown.known_error("velocity") == pytest.approx(1e-4 * SPEED / math.cos(1.0), rel=1e-12)
    assert swing(6, angle, math.inf).known_error("velocity") == 0
    near = swing(2, 1.5)  # Within half an interval no grain moves farther than its speed allows.
    assert near.known_error("displacement") == pytest.approx(1e-4 * SPEED / OMEGA, rel=1e-9)


def test_bounds_of_a_chain_that_may_open():
    """The speed is bounded by one grain with all of the energy, and the path by that speed."""
    masses = np.linspace(2e-6, 1e-6, 12)
    chain = column(12, gravity=0.0, bottom="free", masses=masses)
    scene = struck(chain, 0.1, 1e-4, 3)
    for grains, time in (("all", scene.time[1] / 2), ("1:9", scene.duration)):
        t = simulate(scene.replace(grains=grains), engines.Native(step=2e-8))
        between = Motion(t.scene, 1, t.grains, t.displacement, t.velocity, 1e-3)
        fastest = math.sqrt(2 * scene.energy / masses[-1])
        u = np.abs(t.displacement).max()
        assert between.known_error("velocity") == pytest.approx(1e-3 * fastest, rel=1e-12)
        assert between.known_error("displacement") == pytest.approx(
            1e-3 * (u + fastest * time), rel=1e-12
        )


@pytest.mark.parametrize(("equation", "velocity"), [(1, 1e-5), (3, 10.0), (1, 10.0)])
def test_bounds_of_a_compressed_chain(equation: int, velocity: float):
    """If no contact opens, the energy of the contacts bounds the changes r of their overlaps.

    The bound is (sum of r)^2 <= (delta + 1) E sum of 1 / k. It is not valid for a strong strike.
    """
    chain = column(12, gravity=0.0, top_load=1.0)
    scene = struck(chain, velocity, 4e-4, 3)
    t = simulate(scene, engines.Native(step=2e-8))
    between = Motion(scene, equation, t.grains, t.displacement, t.velocity, 1e-3)
    farthest = math.sqrt(2.5 * scene.energy * (1 / chain.linear_stiffness).sum())
    largest = np.abs(t.displacement).max()
    if equation == 1 and velocity > 1:
        farthest = largest + velocity * scene.time[1] / 2
    assert between.known_error("displacement") == pytest.approx(
        1e-3 * max(largest, farthest), rel=1e-12
    )
    assert between.known_error("velocity") == pytest.approx(1e-3 * velocity, rel=1e-12)


def test_bounds_between_samples_of_one_spring():
    """The bound is v^2 + 2 (omega u)^2: the contact's energy counts for either grain."""
    fine = swing(6, 5.0)
    assert fine.ceiling.shape == (1, 0)
    coarse = swing(4, 7.5)
    phase = np.linspace(0, 7.5, 4)[:-1]
    limit = SPEED * np.sqrt(np.cos(phase) ** 2 + 2 * np.sin(phase) ** 2)
    assert coarse.ceiling.shape == (1, 3)
    assert coarse.ceiling[0] == pytest.approx(limit, rel=1e-9)
    value, error = coarse.peaks("velocity")[1:]
    assert value[0] == pytest.approx(
        np.abs(np.cos(np.linspace(0, 7.5, 4))).max() * SPEED, rel=1e-12
    )
    assert value[0] + error[0] == pytest.approx(
        limit.max() + coarse.known_error("velocity"), rel=1e-9
    )
    value, error = coarse.peaks("displacement")[1:]
    sampled = SPEED / OMEGA * np.abs(np.sin(np.linspace(0, 7.5, 4)))
    high = ((sampled[1:] + sampled[:-1] + coarse.step * limit) / 2).max()
    assert value[0] + error[0] == pytest.approx(high + coarse.known_error("displacement"), rel=1e-9)
    unknown = swing(6, 5.0, equation=0)  # The phase is above 0.7, and the energy is unknown.
    assert np.isinf(unknown.ceiling).all()
    assert swing(20, 5.0, equation=0).ceiling.shape == (1, 0)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("recorded", ["all", "1:10"])
def test_the_energy_within_reach_of_every_grain(linear: bool, recorded: str):
    """For each grain, the bound includes all energy that the wave can carry within an interval."""
    chain = Chain(grains=14, diameter=np.linspace(1e-3, 1.5e-3, 14), top_load=1e-3)
    scene = scene_of(chain, Impulse(velocity=2e-2, grain=3), 5e-5, 6, grains=recorded)
    t = simulate(scene, engines.Native(step=2e-8))
    between = Motion(scene, 3 if linear else 1, t.grains, t.displacement, t.velocity, 0.0)
    h = scene.duration / 5
    fast = scene.highest_frequency
    assert fast * h > 2
    contacts = chain.contacts
    masses = chain.masses
    moves = [int(n) for n in t.grains if n <= 13]
    near = math.ceil(fast * h / 2) + 2
    edge = min(max(moves) + 2, 14)
    speeds, frequencies = np.zeros((2, len(moves), 5))
    for i in range(5):
        u = np.zeros(16)
        u[t.grains] = t.displacement[i]
        v = np.zeros(16)
        v[t.grains] = t.velocity[i]
        closer = u[:-1] - u[1:]
        held = contacts.stiffness * closer**2 / 2 if linear else contacts.energy(closer[None])[0]
        own = [masses[n - 1] * v[n] ** 2 / 2 + held[n - 1] + held[n] for n in range(1, edge + 1)]
        if recorded == "all":
            within = np.array(
                [sum(own[max(n - 1 - near, 0) : n + near]) for n in range(1, edge + 1)]
            )
        else:
            within = np.full(edge, scene.energy)
        stiff = np.zeros(edge + 1)
        for c in range(edge + 1):
            shared = max(within[c - 1] if c > 0 else 0.0, within[c] if c < edge else 0.0)
            one = contacts.of(np.array([c]))
            bound = (
                one.stiffness if linear else one.stiffness_at(one.overlap_bound(np.array([shared])))
            )
            stiff[c] = float(bound[0])
        square = [(stiff[n - 1] + stiff[n]) / masses[n - 1] for n in range(1, edge + 1)]
        for row, n in enumerate(moves):
            speeds[row, i] = math.sqrt(2 * within[n - 1] / masses[n - 1])
            beside = square[max(n - 2, 0) : min(n + 1, edge)]
            frequencies[row, i] = math.sqrt(max(beside))
    known = np.array([recorded == "all" or n < 10 for n in moves])
    allowed = np.where(known, 2.0, 0.7)[:, None]
    expected = np.where(frequencies * h <= allowed, -1.0, speeds)
    assert (expected > 0).any()
    assert between.ceiling == pytest.approx(expected, rel=1e-9)


# --- the largest force at the bottom


@pytest.mark.parametrize("bottom", ["fixed", "wall"])
def test_the_largest_force_on_the_bottom_support(bottom: str):
    """The force is the force at rest plus k v / omega, plus the weight of a fixed grain."""
    if bottom == "fixed":
        chain = SPRING
        stiffness = SPRING.linear_stiffness[0]
        rest = 1.0 + 2 * 3.0 * SPRING.masses[0]
    else:
        chain = column(1, exponent=1.0, top_load=1.0, gravity=3.0, bottom="wall")
        stiffness = float(chain.contacts.stiffness[1])
        rest = 1.0 + 3.0 * chain.masses[0]
    omega = math.sqrt(stiffness / chain.masses[0])
    speed = 0.1
    between = motion_of(simulate(struck(chain, speed, 5 / omega, 13), "native", 1e-10))
    contact = chain.grains - (bottom == "fixed")
    closer, off = between.closest(contact)
    force, error = between.largest_wall_force()
    assert closer == pytest.approx(speed / omega, rel=1e-6)
    assert 2 * between.known_error("displacement") <= off < 1e-3 * closer
    assert force == pytest.approx(rest + stiffness * speed / omega, rel=1e-6)
    assert force == pytest.approx(rest + stiffness * closer, rel=1e-12)
    assert error == pytest.approx(stiffness * off, rel=1e-5)


def test_the_bottom_force_of_distant_samples():
    """The overlap (u_i + u_(i+1) + h times the speed limit) / 2 may occur between two samples."""
    coarse = swing(4, 7.5, error=0.0)
    phase = np.linspace(0, 7.5, 4)
    u = SPEED / OMEGA * np.sin(phase)
    limit = SPEED * np.sqrt(np.cos(phase[:-1]) ** 2 + 2 * np.sin(phase[:-1]) ** 2)
    closer, off = coarse.closest(1)
    assert closer == pytest.approx(u.max(), rel=1e-12)
    assert closer + off == pytest.approx(
        ((u[1:] + u[:-1] + coarse.step * limit) / 2).max(), rel=1e-9
    )


@pytest.mark.parametrize(
    ("chain", "excitation", "fault"),
    [
        ({"gravity": 0.0, "bottom": "free"}, STRIKE, "end: there is no wall at the end 'bottom'"),
        ({}, Drive(end="bottom", amplitude=1e-9, frequency=1e4), "end: the last grain is driven"),
        ({"damping": {"viscoelastic": 1e-7}}, STRIKE, "chain.damping.viscoelastic: .* viscous"),
        ({"law": SOFTENS, "gravity": 0.0}, STRIKE, "chain.law: .* softening contact"),
    ],
)
def test_the_bottom_force_that_approaches_do_not_show(
    chain: dict[str, Any], excitation: Any, fault: str
):
    t = run(column(5, **chain), excitation, 1e-6, 21, 1e-3)
    with pytest.raises(InputError, match=fault):
        motion_of(t).largest_wall_force()


def test_no_closest_approach_without_recording():
    scene = scene_of(column(5), STRIKE, 1e-6, 21, grains=[1, 2, 3])
    between = motion_of(simulate(scene, engines.Native(step=1e-8)))
    with pytest.raises(InputError, match="grains: the grains of contact 4 must be recorded"):
        between.largest_wall_force()
    assert between.closest(2)[0] >= 0


@pytest.mark.parametrize("equation", [0, 1])
def test_errors_of_the_closest_approach_cover_the_deviation(equation: int):
    """The error covers the deviation from many samples for every contact of a chain that opens."""
    chain = column(6, top="wall", top_load=1e-3)
    scene = struck(chain, 1e-3, 6e-5, 1441)
    t = simulate(scene, engines.Native(step=1e-8))
    dense = Motion(scene, 1, t.grains, t.displacement, t.velocity, 0.0)
    true = np.array([dense.closest(contact) for contact in range(6)])
    for every in (10, 9, 6, 5):
        samples = 1440 // every + 1
        u = t.displacement[::every]
        v = t.velocity[::every]
        few = Motion(scene.replace(samples=samples), equation, t.grains, u, v, 0.0)
        value, error = np.array([few.closest(contact) for contact in range(6)]).T
        assert (np.abs(value - true[:, 0]) <= error + true[:, 1]).all()
        assert (error < (3e-2 if equation == 0 else 1e-3) * value).all()
