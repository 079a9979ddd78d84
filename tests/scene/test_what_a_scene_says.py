"""Numbers, remarks, tables and pictures of a scene, against their definitions."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.faults import fault_keys, faults, remarks
from helpers.independent_theory import dense_modes
from matplotlib.figure import Figure

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    InputError,
    Law,
    Material,
    Packet,
    Profile,
    Riemann,
    Scene,
    plan,
    simulate,
    simulate_many,
    work_precision,
)
from lmpchain.disorder import ensemble, spreading
from lmpchain.engines.lammps.export import write_deck
from lmpchain.scene.excitation import EXCITATIONS
from lmpchain.stability import stability

COLUMN = column(9)
LOADED = column(9, gravity=0.0, top_load=1e-3, top="wall", bottom="wall")
WAVE = {"amplitude": 1e-12, "frequency": 3e4}


def acted_on(excitation: Any, chain: Chain = COLUMN, **keys: Any) -> Scene:
    return scene_of(chain, excitation, **{"duration": 1e-4, "samples": 11} | keys)


# --- times at which quantities are gathered


@pytest.mark.parametrize(
    "needed", [0.3, 0.99, 1.01, 1.99, 2.01, 2.99, 3.01, 3.99, 4.01, 5.9, 6.1, 8.1, 12.1, 90.0]
)
def test_the_number_of_fine_intervals_is_the_smallest_sufficient_one(needed: float) -> None:
    """The limit is half a radian of the highest frequency, which is the drive's here."""
    drive = Drive(amplitude=1e-15, frequency=1e7)
    samples = 11
    duration = 0.5 * needed * (samples - 1) / (2 * np.pi * 1e7)
    scene = acted_on(drive, duration=duration, quantities=["peak_velocity"])
    assert scene.highest_frequency == pytest.approx(2e7 * np.pi, rel=1e-14)
    allowed = sorted([2**n for n in range(12)] + [3 * 2**n for n in range(12)])
    assert scene.finer == next(count for count in allowed if count >= needed)
    assert scene.fine.samples == 10 * scene.finer + 1
    assert scene.fine.duration == duration
    assert not scene.fine.quantities
    plain = acted_on(drive, duration=duration)
    assert plain.finer == 1
    assert plain.fine is plain
    assert plain.ungathered is plain
    assert scene.ungathered == plain


def test_quantities_are_checked_by_name_and_contact() -> None:
    for asked, said in (
        ([], "must be a list of names"),
        ("peak_velocity", "must be a list of names"),
        (["peak_force"], 'needs the number of a contact, as in "peak_force:40"'),
        (["force:x"], 'needs the number of a contact, as in "force:40"'),
        (["force:01"], "needs the number"),
        (["force:-1"], "needs the number"),
        (["peak_velocty"], "peak_velocity"),
        ([3], "peak_displacement"),
        (["force:2", "force:2"], "names a quantity twice"),
        (["force:9"], "the contacts are numbered 1 to 8 (got 9)"),
        (["peak_velocity", "force:0"], "the contacts are numbered 1 to 8 (got 0)"),
    ):
        ((key, text),) = faults(acted_on, Impulse(velocity=1e-6), quantities=asked)
        assert key == "quantities"
        assert said in text
    scene = acted_on(
        Impulse(velocity=1e-6), LOADED, quantities=["force:0", "peak_force:9", "arrival_time"]
    )
    assert scene.contacts == {"force:0": 0, "peak_force:9": 9}
    soft = Law("k*(o*exp(-(o/L)**2) + 0.02*o)", k=1e6, L=1e-8)
    viscous = LOADED.replace(top_load=0.0, law=soft, damping={"viscoelastic": 1e-9})
    fault = "is not found in viscous contacts whose force may decrease with the overlap"
    told = faults(acted_on, Impulse(velocity=1e-9), viscous, quantities=["force:1", "peak_force:2"])
    cure = "ask for force:2, the force over time"
    assert told == [("quantities", f"peak_force:2 {fault}: {cure}")]
    acted_on(Impulse(velocity=1e-9), viscous, quantities=["force:1"])


def test_recorded_grains_are_numbered_and_counted() -> None:
    for grains, numbers in (
        ("all", range(1, 10)),
        ("2:5", range(2, 6)),
        ([7, 3], [7, 3]),
        ("9:9", [9]),
        ([1], [1]),
    ):
        scene = acted_on(Impulse(velocity=1e-6), grains=grains)
        assert scene.recorded.tolist() == list(numbers)
        assert scene.count(COLUMN) == len(numbers)
    all_or_some = 'must be "all", a range such as "1:200", or a list of grains'
    for grains, said in (
        ("0:3", "grains are numbered 1 to 9 (got 0 to 3)"),
        ("3:10", "grains are numbered 1 to 9 (got 3 to 10)"),
        ("5:4", "grains are numbered 1 to 9 (got 5 to 4)"),
        ([3, 12], "grains are numbered 1 to 9 (got 3 to 12)"),
        ([3, 1, 3], "names a grain twice"),
        *((wrong, all_or_some) for wrong in ([], [True], [1.0], 3)),
        *((wrong, f"{all_or_some} (got ") for wrong in ("1:2:3", "1:" + "9" * 19)),
    ):
        with pytest.raises(InputError) as caught:
            acted_on(Impulse(velocity=1e-6), grains=grains)
        assert caught.value.faults[0][0] == "grains"
        assert caught.value.faults[0][1].startswith(said), grains
    assert acted_on(Impulse(velocity=1e-6), grains=np.array([2, 4])).recorded.tolist() == [2, 4]
    assert acted_on(Impulse(velocity=1e-6), grains="1:" + "0" * 17 + "9").count(COLUMN) == 9


def test_samples_and_durations_have_limits() -> None:
    for keys, key in (
        ({"samples": 1}, "samples"),
        ({"samples": 10**8 + 1}, "samples"),
        ({"duration": 1.1e12}, "duration"),
        ({"duration": 0.0}, "duration"),
    ):
        assert fault_keys(acted_on, Impulse(velocity=1e-6), **keys) == [key]
    least = np.finfo(float).tiny
    assert acted_on(Impulse(velocity=1e-6), duration=10.001 * least).samples == 11
    with pytest.raises(InputError, match=r"11 samples in .* s are too close together for double"):
        acted_on(Impulse(velocity=1e-6), duration=9.99 * least)
    assert struck(COLUMN, 1e-6, 1e-5).samples == 101


def test_a_long_duration_causes_a_remark() -> None:
    keys = {"chain": COLUMN, "excitation": Impulse(velocity=1e-6), "samples": 11}
    assert not remarks(Scene, duration=1.0, **keys)
    (text,) = remarks(Scene, duration=100.0, **keys)
    long = "duration: 100 s is long for a wave in grains of 1 mm"
    assert text == f"{long}; times are in seconds (100 us is 1e-4)"


def test_long_durations_of_boulders_cause_no_remark() -> None:
    boulders = Chain(grains=11, diameter=0.2, gravity=0, bottom="wall")
    keys = {"chain": boulders, "excitation": Impulse(velocity=1e-6), "samples": 11}
    assert not remarks(Scene, duration=3600.0, **keys)
    (text,) = remarks(Scene, duration=3601.0, **keys)
    assert text.startswith("duration: 3601 s is long for a wave in grains of 200 mm")


@pytest.mark.parametrize(
    ("constants", "remark"),
    [
        ({"youngs_modulus": 62.0}, r"youngs_modulus: 62 Pa .*; moduli are in pascals \(62 GPa is"),
        ({"youngs_modulus": 62e3}, r"youngs_modulus: 62000 Pa .*pascals"),
        ({"density": 2.4}, r"density: 2.4 kg/m3 .* \(2.4 g/cm3 is 2400\)"),
    ],
)
def test_materials_in_other_units_cause_a_remark(constants: dict[str, float], remark: str) -> None:
    usual = {"density": 2426.0, "youngs_modulus": 62e9, "poissons_ratio": 0.2}
    with pytest.warns(UserWarning, match=f"^{remark}"):
        Material(**usual | constants)


def test_usual_materials_cause_no_remark(recwarn: pytest.WarningsRecorder) -> None:
    # Cork and rubber are the softest and lightest materials of grains.
    Material(density=120.0, youngs_modulus=1e6, poissons_ratio=0.0)
    assert not recwarn.list


@pytest.mark.parametrize(
    "take", [simulate, plan, stability, work_precision, lambda scene: simulate_many([scene])]
)
@pytest.mark.parametrize("thing", [None, "scene.toml", {"chain": {}}, COLUMN])
def test_invalid_scenes_are_rejected(take: Any, thing: Any) -> None:
    with pytest.raises(InputError, match=r"^scene(s\.0)?: must be a Scene \(got .*Scene.from_toml"):
        take(thing)


def test_the_number_of_chains_in_an_average_is_limited() -> None:
    scene = acted_on(Impulse(velocity=1e-12))
    for average in (ensemble, spreading):
        with pytest.raises(InputError, match=r"^realisations: must be a whole number from 1 to 10"):
            average(scene, 5.0, realisations=10**11, seed=1)


def test_decks_have_a_number_of_steps_that_lammps_can_count(tmp_path: Path) -> None:
    scene = acted_on(Impulse(velocity=1e-6), duration=1e-5, samples=2)
    # Ten times 300 million steps exceed 32 bits.
    file = write_deck(scene, tmp_path, step=1e-5 / 3e8)
    assert "index 300000000 " in file.read_text()
    assert "thermo          ${every}" in file.read_text()
    usual = write_deck(scene.replace(samples=11), tmp_path, step=1e-8)
    assert "thermo          $(10*v_every)" in usual.read_text()


# --- the linear chain


def springs_strain(chain: Chain, excitation: Any, duration: float) -> float:
    """Return the bound on strains from each spring in series with the others between fixed ends."""
    contacts = chain.contacts
    there = contacts.exists
    k = contacts.stiffness[there]
    if excitation.does_work:
        root = excitation.energy_norm(chain, duration)
    else:
        u, v = excitation.initial(chain)
        stretch = -np.diff(np.concatenate(([0.0], u, [0.0])))
        root = np.sqrt((chain.masses * v**2).sum() + (contacts.stiffness * stretch**2).sum())
    if there[0] and not excitation.does_work:
        others = [(1 / np.delete(k, n)).sum() for n in range(k.size)]
        k = k + 1 / np.array(others)
    return float((root / np.sqrt(k) / contacts.overlap[there]).max())


HELD = {
    "chain between walls": LOADED,
    "column": COLUMN,
    "column on a wall": COLUMN.replace(bottom="wall"),
}
AT_START = {
    "impulse": Impulse(velocity=-1e-6, grain=3),
    "moved": Displacement(displacement=1e-12, grain=2),
    "both": Profile(
        displacement=1e-12 * np.sin(np.arange(9.0)) * (np.arange(9) < 8),
        velocity=1e-6 * np.eye(9)[2],
    ),
}


@pytest.mark.parametrize("chain", HELD.values(), ids=HELD)
@pytest.mark.parametrize("excitation", AT_START.values(), ids=AT_START)
def test_strains_of_the_linear_chain_are_bounded_by_its_energy(
    chain: Chain, excitation: Any
) -> None:
    """The bound agrees with another form, and no superposition of modes exceeds it."""
    scene = acted_on(excitation, chain)
    bound = springs_strain(chain, excitation, scene.duration)
    assert scene.linear_strain == pytest.approx(bound, rel=1e-12)
    squares, shapes = dense_modes(chain)
    root = np.sqrt(chain.masses[: chain.movable])
    u, v = (shapes.T @ (root * x[: chain.movable]) for x in excitation.initial(chain))
    omega = np.sqrt(squares)
    for t in np.linspace(0, 1e-4, 400):
        motion = shapes @ (u * np.cos(omega * t) + v / omega * np.sin(omega * t)) / root
        closer = chain.contacts.closer(np.append(motion, np.zeros(9 - chain.movable)))
        pressed = chain.contacts.pressed
        assert np.abs(closer[pressed] / chain.contacts.overlap[pressed]).max() <= bound


def test_strains_of_a_driven_linear_chain() -> None:
    start = Profile(velocity=1e-6 * np.eye(9)[3], displacement=1e-12 * np.eye(9)[4])
    for excitation in (
        Force(grain=4, **WAVE | {"amplitude": -1e-9}),
        Drive(**WAVE, grain=0),
        Drive(**WAVE, grain=0, start=start),
    ):
        scene = acted_on(excitation, LOADED)
        strain = springs_strain(LOADED, excitation, 1e-4)
        assert scene.linear_strain == pytest.approx(strain, rel=1e-12)
    push = Force(grain=4, **WAVE | {"amplitude": -1e-9})
    impulse = 1e-9 * 2 / (2 * np.pi * 3e4) * 6  # Six arches in 100 us.
    norm = impulse / np.sqrt(LOADED.masses[3])
    assert push.energy_norm(LOADED, 1e-4) == pytest.approx(norm, rel=1e-12)
    k = LOADED.contacts.stiffness
    for grain in (0, 1):
        drive = Drive(**WAVE, grain=grain)
        path = 1e-12 * (1 + 12)
        norm = np.sqrt(k[grain]) * path
        assert drive.energy_norm(LOADED, 1e-4) == pytest.approx(norm, rel=1e-12)
        begun = np.sqrt(LOADED.masses[3] * 1e-12 + (k[4] + k[5]) * 1e-24)
        moving = drive.replace(start=start)
        assert moving.energy_norm(LOADED, 1e-4) == pytest.approx(begun + norm, rel=1e-12)
    touching = COLUMN.replace(top="wall")
    assert acted_on(Impulse(velocity=1e-9), touching).linear_strain == np.inf
    assert acted_on(Impulse(velocity=1e-9), COLUMN.replace(gravity=0.0)).linear_strain == np.inf


# --- the forcing


def test_a_short_push_moves_its_grain_like_an_oscillator() -> None:
    """A short force is bounded by its impulse, and a slow force by its work."""
    spring = {"grains": 1, "diameter": 1e-3, "exponent": 1.0, "bottom": "wall", "masses": [2e-6]}
    chain = Chain(**spring, wall_constants=[0.0, 50.0])
    blow = Force(shape="half-sine", amplitude=-1e-3, duration=1e-7)
    (u,), (v,) = blow.largest(chain)
    speed = 1e-3 * 2e-7 / np.pi / 2e-6
    assert (u, v) == pytest.approx((speed / 5000.0, speed), rel=1e-12)
    assert blow.strongest(chain, 1.0) == pytest.approx((u, v), rel=1e-15)
    assert blow.strongest(chain, 1e-6) == pytest.approx((v * 1e-6, v), rel=1e-15)
    slow = Force(amplitude=1e-4, frequency=1.0)
    (u,), (v,) = slow.largest(chain)
    assert v == pytest.approx(np.sqrt(2 * 1e-4 * (1e-4 / 50.0) / 2e-6), rel=1e-12)
    assert u == pytest.approx(np.sqrt(2) * 1e-4 / 50.0, rel=1e-12)
    two = Chain(**spring | {"top": "wall", "top_load": 1e-3}, wall_constants=[20.0, 50.0])
    (u,), (v,) = slow.largest(two)  # The softer contact determines the distance.
    assert v == pytest.approx(np.sqrt(2 * 1e-4 * (1e-4 / 20.0) / 2e-6), rel=1e-12)
    assert not np.any(Force(amplitude=0.0, frequency=1.0).largest(chain))
    assert not np.any(slow.initial(chain))


def test_the_external_force_of_drives_and_forces(rng: np.random.Generator) -> None:
    """The external force and its body's motion agree for driven grains, walls and forces."""
    time = np.array([0.0, 1e-5, 3e-5])
    force, rate = rng.normal(size=(2, 3, 10))
    velocity = rng.normal(size=(3, 9))
    w = 2 * np.pi * 3e4
    a = 1e-12
    speed = a * w * np.cos(w * time)
    bend = -a * w**2 * np.sin(w * time)
    wall = Drive(**WAVE, grain=0).push(LOADED, time, force, rate, velocity)
    for field, expected in zip(wall[:4], (force[:, 0], rate[:, 0], speed, bend), strict=True):
        assert field == pytest.approx(expected, rel=1e-12)
    assert (wall.inertia, wall.on_grain) == (0.0, False)
    grain = Drive(**WAVE).push(LOADED, time, force, rate, velocity)
    held = force[:, 1] - force[:, 0], rate[:, 1] - rate[:, 0]
    for field, expected in zip(grain[:4], (*held, speed, bend), strict=True):
        assert field == pytest.approx(expected, rel=1e-12)
    assert (grain.inertia, grain.on_grain) == (LOADED.masses[0], True)
    for bottom, last in (("wall", 9), ("fixed", 8)):
        chain = LOADED.replace(bottom=bottom)
        base = Drive(**WAVE, end="bottom").push(chain, time, force, rate, velocity)
        # The contact above the base pushes it down, so that an upward force must hold it.
        held = -force[:, last], -rate[:, last]
        for field, expected in zip(base[:4], (*held, speed, bend), strict=True):
            assert field == pytest.approx(expected, rel=1e-12)
        of_grain = bottom == "fixed"
        assert (base.inertia, base.on_grain) == (of_grain * chain.masses[-1], of_grain)
    push = Force(grain=4, **WAVE).push(LOADED, time, force, rate, velocity)
    given = a * np.sin(w * time)
    hurried = (given + force[:, 3] - force[:, 4]) / LOADED.masses[3]
    for field, expected in zip(push[:4], (given, speed, velocity[:, 3], hurried), strict=True):
        assert field == pytest.approx(expected, rel=1e-12)
    assert (push.inertia, push.on_grain) == (0.0, True)
    assert Impulse(velocity=1.0).push(LOADED, time, force, rate, velocity) is None


POINTS = {"times": [0.0, 1e-4], "displacement": [0.0, 1e-12]}
SWIFT = "rad/s, which is too fast to compute: use SI units"
WAYS = "amplitude and frequency, with or without cycles, or times and"
SPACED = "times: must be 0 or more, and increase by more than 1e-12 of the last"
BEGIN = "displacement: must begin with 0, the position of"
CLOSE = {"times": [0.0, 0.99e-16, 1e-4], "displacement": [0.0, 0.0, 0.0]}
HALF_SINE = {"shape": "half-sine", "amplitude": 1e-12}
ALONE = {"amplitude": 1e-12}
PATH: dict[str, Any] = {"times": [0.0, 1e-4], "displacement": [0.0, 0.0]}
REFUSED: list[tuple[Any, dict[str, Any], str]] = [
    (Drive, ALONE | {"frequency": 1.6e19}, f"frequency: corresponds to 1e+20 {SWIFT}"),
    (Drive, WAVE | {"frequency": 1e19, "cycles": 0.1}, f"cycles: corresponds to 6.9e+20 {SWIFT}"),
    (Force, HALF_SINE | {"duration": 3e-20}, f"duration: corresponds to 1e+20 {SWIFT}"),
    (Drive, ALONE, f'amplitude: give shape = "piston", velocity and rise, or {WAYS} displacement'),
    (Force, ALONE | {"duration": 1e-5}, f"amplitude: give {WAYS} force, or shape, amplitude and"),
    (
        Drive,
        PATH | {"displacement": [0.0, -1.1e100]},
        "displacement: must be at most 1e+100",
    ),
    (Drive, PATH | {"displacement": [0.0]}, "displacement: must have one entry for each of two or"),
    (Drive, PATH | {"times": [-1e-9, 1e-4]}, SPACED),
    (Drive, CLOSE, SPACED),
    (Drive, PATH | {"times": [0.0, 0.9e-20]}, "times: are 9e-21 s apart, which is too little to c"),
    (Drive, PATH | {"displacement": [1e-12, 0.0]}, f"{BEGIN} grain 1 at rest"),
    (Drive, PATH | {"displacement": [1e-12, 0.0], "grain": 0}, f"{BEGIN} the wall at rest"),
    (Drive, PATH | {"displacement": [1e-12, 0.0], "end": "bottom"}, f"{BEGIN} the base at rest"),
]


@pytest.mark.parametrize(("kind", "keys", "fault"), REFUSED)
def test_invalid_forcings_are_rejected_with_their_number(
    kind: Any, keys: dict[str, Any], fault: str
) -> None:
    ((key, text),) = faults(kind, **keys)
    assert f"{key}: {text}".startswith(fault)


def test_forcings_at_the_limits_are_valid() -> None:
    Drive(amplitude=1e-12, frequency=1.59e19)
    Drive(times=[0.0, 1e-4], displacement=[0.0, -1e100])
    Drive(times=[0.0, 1.01e-16, 1e-4], displacement=[0.0, 0.0, 0.0])
    Drive(times=[0.0, 1.1e-20], displacement=[0.0, 0.0])
    Force(times=[0.0, 1e-4], force=[1.0, 0.0])


def test_forcings_that_do_not_fit_chain_or_duration_are_rejected() -> None:
    one = column(2)
    for excitation, chain, fault in (
        (Drive(**WAVE, grain=0), COLUMN, "grain: 0 moves the top wall, but the chain has no top w"),
        (Drive(**WAVE), one, "kind: no other grain can move if grain 1 is driven: use more grains"),
        (Impulse(velocity=1e-6, grain=10), COLUMN, "grain: there is no grain 10: the chain has 9"),
        (Impulse(velocity=1e-6, grain=9), COLUMN, "grain: grain 9 is held; choose one of 1 to 8"),
        (Force(grain=9, **WAVE), COLUMN, "grain: grain 9 is held; choose one of 1 to 8"),
        (Profile(velocity=np.zeros(8)), COLUMN, "velocity: must have one entry a grain, 9 in all"),
        (Profile(velocity=np.ones(9)), COLUMN, "velocity: must be 0 for grain 9, which is held"),
    ):
        ((key, text),) = faults(acted_on, excitation, chain)
        assert f"{key}: {text}".startswith(fault)
    for excitation, chain in (
        (Drive(**POINTS), COLUMN),
        (Drive(**WAVE), one.replace(bottom="wall")),
        (Drive(**WAVE, grain=0), LOADED),
        (Impulse(velocity=1e-6, grain=8), COLUMN),
        (Impulse(velocity=1e-6, grain=9), LOADED),
        (Profile(velocity=np.ones(9)), LOADED),
    ):
        acted_on(excitation, chain)


def test_every_excitation_describes_itself() -> None:
    packet = Packet(frequency=1e3, width=0.5, grain=5, amplitude=1e-13)
    impulse = Impulse(velocity=-2e-3, grain=2)
    moved = Displacement(displacement=1e-9)
    profile = Profile(velocity=np.zeros(9))
    step = Riemann(velocity=(0, 0), strain=(0, 0), grain=3)
    drive = Drive(**WAVE)
    force = Force(**WAVE)
    kinds = (impulse, moved, profile, packet, step, drive, force)
    names = "impulse displacement profile packet riemann drive force"
    assert list(EXCITATIONS) == names.split()
    assert [kind.label for kind in kinds] == [
        "an impulse of -2 mm/s",
        *(f"a {kind.kind}" for kind in kinds[1:]),
    ]
    assert [kind.does_work for kind in kinds] == [False] * 5 + [True] * 2
    assert [kind.linear for kind in kinds] == [True] * 7
    assert [kind.of_chain for kind in kinds] == [False, False, False, True, True, False, True]
    assert [kind.driven for kind in kinds] == [0, 0, 0, 0, 0, 1, 0]
    assert Drive(**WAVE, grain=0).driven == 0
    piston = Drive(shape="piston", velocity=-0.1, rise=1e-5)
    assert drive.numbers.tolist() == [1e-12, 3e4]
    assert piston.numbers.tolist() == [-0.1]
    assert Drive(**POINTS).numbers.tolist() == [0.0, 1e-12]
    assert [kind.strike_velocity for kind in kinds] == [-2e-3, 0, 0, 0, 0, 0, 0]
    assert [kind.strikes_top for kind in kinds] == [False] * 7
    assert [kind.wall is not None for kind in kinds] == [False] * 7
    assert Drive(**WAVE, grain=0).wall.amplitude == 1e-12
    omega = 6e4 * np.pi
    assert [kind.fastest for kind in kinds] == pytest.approx([0] * 5 + [omega] * 2, rel=1e-14)
    assert [kind.kink_spacing for kind in kinds] == [np.inf] * 7
    assert Drive(**POINTS).kink_spacing == pytest.approx(1e-4, rel=1e-11)
    assert not Drive(**POINTS).linear
    assert [kind.smooth_until(1.0) for kind in kinds] == [True] * 7
    assert impulse.energy(COLUMN) == pytest.approx(2e-6 * COLUMN.masses[1], rel=1e-15)
    assert impulse.strongest(COLUMN, 1.0) == (0.0, 2e-3)
    assert moved.strongest(COLUMN, 1.0) == (1e-9, 0.0)
    assert [kind.energy(COLUMN) for kind in (drive, force)] == [np.inf] * 2
    ends = Profile(
        displacement=[0, 0, 1e-12, 0, 0, 0, 1e-12, 0, 0], velocity=[0, 1e-6, 0, 0, 0, 0, 0, 0, 0]
    )
    reached = [each.reach(COLUMN) for each in (impulse, profile, ends, drive)]
    assert reached == [(2, 2), (1, 1), (2, 7), (1, 1)]
    assert Drive(**WAVE, start=ends).reach(COLUMN) == (1, 7)
    norm = np.sqrt(COLUMN.masses[1]) * 2e-3
    assert impulse.energy_norm(COLUMN, 1.0) == pytest.approx(norm, rel=1e-12)
    bend = -1e-12 * omega**2 * np.sin(omega * 1e-5)
    assert drive.acceleration(np.array([1e-5])) == pytest.approx(bend, rel=1e-12)


# --- pictures and tables


def picture(scene: Scene) -> Any:
    return scene.plot(Figure().subplots())


def test_the_picture_of_a_forcing_shows_its_course_over_time() -> None:
    for excitation, name, unit in (
        (Drive(**WAVE), "displacement", "m"),
        (Force(**WAVE), "force", "N"),
    ):
        axes = picture(acted_on(excitation))
        (line,) = axes.get_lines()
        time = line.get_xdata()
        assert (time[0], time[-1]) == (0.0, 1e-4)
        assert time.size > 500
        course = 1e-12 * np.sin(6e4 * np.pi * time)
        assert line.get_ydata() == pytest.approx(course, rel=1e-9, abs=1e-24)
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("time", f"{name}, downward")
        axes.figure.canvas.draw()
        assert axes.xaxis.get_major_formatter()(1e-4).endswith("µs")
        assert axes.yaxis.get_major_formatter()(1e-12).endswith(f"p{unit}")


def test_the_picture_of_an_initial_state_shows_the_grains_around_it() -> None:
    chain = column(60)
    axes = picture(acted_on(Impulse(velocity=1e-4, grain=30), chain))
    (line,) = axes.get_lines()
    assert line.get_xdata().tolist() == list(range(20, 41))
    assert line.get_ydata().tolist() == [1e-4 * (n == 30) for n in range(20, 41)]
    assert axes.get_xlabel() == "grain, from the top"
    # A single quantity names the axis, with its unit.
    axes.figure.draw_without_rendering()
    assert axes.get_legend() is None
    assert axes.get_ylabel() == "velocity at t = 0, downward (µm/s)"
    both = Profile(displacement=1e-12 * np.eye(60)[2], velocity=1e-6 * np.eye(60)[57])
    axes = picture(acted_on(both, chain))
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["displacement (m)", "velocity (m/s)"]
    assert axes.get_ylabel() == "at t = 0, downward"
    assert [line.get_xdata().tolist() for line in axes.get_lines()] == [list(range(1, 61))] * 2
    assert np.flatnonzero(axes.get_lines()[0].get_ydata()).tolist() == [2]


def test_a_notebook_shows_a_scene() -> None:
    scene = acted_on(Impulse(velocity=1e-4), grains="2:5")
    html = scene._repr_html_()
    cells = re.findall(r"<td[^>]*>(.*?)</td>", html)
    rows = {cells[n]: cells[n + 1 : n + 3] for n in range(0, len(cells) - 2, 3)}
    assert rows["recorded"] == ["11 times to 0.0001 s, 4 grains", ""]
    assert rows["strike number"] == [f"{scene.strike_number:.4g}", "too strong for linear theory"]
    once = acted_on(Impulse(velocity=1.0)).strike_number
    for number, verdict in (
        *((0.036, "weak enough for linear theory"), (0.038, "almost linear")),
        *((0.39, "almost linear"), (0.41, "too strong for linear theory")),
    ):
        assert verdict in acted_on(Impulse(velocity=number / once))._repr_html_()
    loose = column(5, gravity=0.0)
    assert "linear theory does not apply" in acted_on(Impulse(velocity=1e-4), loose)._repr_html_()
    assert rows["excitation"][0].startswith("Impulse(")
    assert rows["chain"][0].startswith("Chain(")
    assert "data:image/png" in html
    long = struck(column(10**6 + 1, gravity=0.01), 1e-9, 1e-6)
    assert "data:image/png" not in long._repr_html_()
    assert "strike number" not in long._repr_html_()
