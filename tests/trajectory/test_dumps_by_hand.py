"""Synthetic dumps, frame by frame: reading, and both sides of every limit."""

import gzip
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.faults import faults

from lmpchain import Chain, Displacement, Impulse, Scene, Trajectory, simulate
from lmpchain.errors import InputError
from lmpchain.scene.lammps_column import RunOptions
from lmpchain.trajectory.dump_frames import is_dump
from lmpchain.trajectory.lammps_dump import read_grains, scene_of_run
from lmpchain.trajectory.record import Cost, ErrorEstimate

CHAIN = Chain(grains=5, material="glass", diameter=[1e-3, 1.2e-3, 1e-3, 0.8e-3, 1e-3])
SAMPLES = 4
# The samples are too far apart to compare displacements with velocities.
SCENE = Scene(
    chain=CHAIN, excitation=Impulse(velocity=2e-3, grain=2), duration=3e-4, samples=SAMPLES
)
TIMES = np.arange(SAMPLES)[:, None]
U = 1e-9 * TIMES * np.array([0.5, 2.0, 0.7, 0.2, 0.0])
V = 2e-3 * np.array(
    [[0, 1, 0, 0, 0], [0.1, 0.9, 0.1, 0, 0], [0.2, 0.7, 0.2, 0.1, 0], [0.3, 0.5, 0.3, 0.1, 0]]
)
NUMBERS = np.array([4, 1, 3, 2, 5])  # Atom numbers from the top.
REST = 0.01 - np.append(0, np.cumsum(CHAIN.contact_lengths[1:-1] - CHAIN.equilibrium_overlap))


def dump(
    path: Path,
    u: np.ndarray = U,
    v: np.ndarray = V,
    rest: np.ndarray = REST,
    columns: str = "id x y z vz v_phi",
    steps: Any = (100, 150, 200, 250),
    form: str = "%.17g",
    up: int = 1,
    numbers: np.ndarray = NUMBERS,
    more: dict[str, np.ndarray] | None = None,
) -> Path:
    """Write a dump with an order of atoms that changes from frame to frame.

    `more` contains further columns (T, N) by name.
    """
    text = ""
    for sample, step in enumerate(steps):
        z = up * (rest - u[sample])
        fields = {"z": z, "zu": z, "zs": z, "vz": -up * v[sample], "v_phi": u[sample]}
        fields |= {key: values[sample] for key, values in (more or {}).items()}
        text += (
            f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{z.size}\nITEM: BOX BOUNDS ff ff ff\n"
        )
        text += "-1 1\n-1 1\n-1 1\n" + f"ITEM: ATOMS {columns}\n"
        for n in np.roll(np.arange(z.size), sample):
            words = [
                str(numbers[n]) if key == "id" else form % fields[key][n] if key in fields else "0"
                for key in columns.split()
            ]
            text += " ".join(words) + "\n"
    path.write_text(text)
    return path


def fault(path: Path, scene: Scene = SCENE, *more: Any) -> str:
    """Return the message with which a dump is rejected."""
    ((key, why),) = faults(Trajectory.from_dump, path, scene, *more)
    assert key in (str(path), "axis")
    return why


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    "columns", ["id x y z vz v_phi", "v_phi vz z y x id", "id zu yu xu v_phi vx vy vz"]
)
def test_everything_of_a_dump_is_read(tmp_path: Path, columns: str, packed: bool):
    path = dump(tmp_path / "run.dump", columns=columns)
    if packed:
        content = path.read_bytes()
        path = tmp_path / "run.dump.gz"
        path.write_bytes(gzip.compress(content))
    assert is_dump(path)
    t = Trajectory.from_dump(path, SCENE)
    assert np.array_equal(t.displacement, U)
    assert np.array_equal(t.velocity, V)
    assert np.array_equal(t.time, SCENE.time)
    assert t.grains.tolist() == [1, 2, 3, 4, 5]
    assert (t.engine, t.equation) == ("lammps", 1)
    assert t.error_estimate == ErrorEstimate(0.0, math.inf)
    assert t.cost.step_s == pytest.approx(2e-6, rel=1e-12)
    step = t.cost.step_s
    assert t.cost == Cost(0.0, 0.0, 0.0, 150, 150, 5, "unknown", step, 1)
    assert t.provenance["dump"] == str(path)
    assert t.provenance["displacement"] == "v_phi"
    assert t.provenance["column"] == "along z, z points up"


@pytest.mark.parametrize("up", [1, -1])
def test_displacements_follow_from_heights(tmp_path: Path, up: int):
    path = dump(tmp_path / "run.dump", columns="id x y z vz", up=up)
    t = Trajectory.from_dump(path, Scene(**SCENE.given() | {"grains": [4, 2]}))
    assert t.grains.tolist() == [4, 2]
    np.testing.assert_allclose(t.displacement, U[:, [3, 1]], rtol=0, atol=4e-18)
    assert np.array_equal(t.velocity, V[:, [3, 1]])
    assert t.provenance["displacement"] == "heights minus first heights"
    assert t.provenance["column"] == f"along z, z points {'up' if up > 0 else 'down'}"
    other = Trajectory.from_dump(path, SCENE, up * REST)
    np.testing.assert_allclose(other.displacement, U, rtol=0, atol=4e-18)
    assert other.provenance["displacement"] == "heights minus given heights"


@pytest.mark.parametrize("columns", ["id x y z vz v_phi", "id x y z vx vy vz"])
def test_a_single_grain_on_a_wall_is_read(tmp_path: Path, columns: str):
    """It has no neighbour, so its velocity alone shows which way the column points."""
    chain = Chain(grains=1, diameter=1e-3, bottom="wall", gravity=0.0)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=3e-6, samples=20)
    answer = simulate(scene)
    motion = (answer.displacement, answer.velocity)
    for up in (1,) if "v_phi" in columns else (1, -1):
        frames = {"rest": np.array([0.01]), "numbers": np.array([1]), "steps": range(0, 200, 10)}
        path = dump(tmp_path / "one.dump", *motion, columns=columns, up=up, **frames)
        for rest in (None, [0.01 * up]):
            t = Trajectory.from_dump(path, scene, rest, axis="z")
            assert np.array_equal(t.velocity, answer.velocity)
            np.testing.assert_allclose(t.displacement, answer.displacement, rtol=0, atol=1e-17)
    with pytest.raises(InputError, match=r"axis: .* give the axis of the column"):
        Trajectory.from_dump(path, scene)
    with pytest.raises(InputError, match="has 1 grain: a column has two or more"):
        scene_of_run([path])


def test_initial_displacements_are_added_to_heights(tmp_path: Path):
    scene = Scene(**SCENE.given() | {"excitation": Displacement(displacement=3e-9, grain=3)})
    u = 3e-9 * np.array([0, 0, 1, 0, 0]) + U
    path = dump(tmp_path / "run.dump", u=u, v=V - V[0], columns="id x y z vz")
    np.testing.assert_allclose(
        Trajectory.from_dump(path, scene).displacement, u, rtol=0, atol=4e-18
    )


@pytest.mark.parametrize(("off", "good"), [(0.9e-6, True), (1.1e-6, False), (1e-3, False)])
def test_a_dump_of_a_scene_with_another_strike_is_rejected(tmp_path: Path, off: float, good: bool):
    """The initial state must agree to a millionth of the largest value in the dump."""
    scene = Scene(**SCENE.given() | {"excitation": Impulse(velocity=2e-3 * (1 - off), grain=2)})
    path = dump(tmp_path / "run.dump")
    if good:
        assert np.array_equal(Trajectory.from_dump(path, scene).velocity, V)
        return
    why = fault(path, scene)
    assert why.startswith("grain 2 begins with a velocity of 0.002 m/s, but with 0.00")
    assert why.endswith("give the scene that the dump was made for")


@pytest.mark.parametrize(("off", "good"), [(0.9e-6, True), (1.1e-6, False)])
def test_a_dump_with_another_initial_state_is_rejected(tmp_path: Path, off: float, good: bool):
    u = U.copy()
    u[0, 3] = off * U.max()
    path = dump(tmp_path / "run.dump", u=u, rest=REST)
    if good:
        assert np.array_equal(Trajectory.from_dump(path, SCENE).displacement, u)
    else:
        assert fault(path).startswith(
            f"grain 4 begins with a displacement of {u[0, 3]:.6g} m, but with 0 in the scene:"
        )


def test_frames_agree_with_the_samples(tmp_path: Path):
    path = dump(tmp_path / "run.dump", steps=(0, 50, 100))
    assert fault(path).startswith(
        "has 3 whole frames, but the scene has 4 samples over a duration of 0.0003 s: set samples"
    )
    for steps in ((0, 50, 100, 151), (0, 51, 100, 150)):
        assert fault(dump(path, steps=steps)).startswith("its frames are not equally far apart")
    again = np.concatenate([U, U, U]), np.concatenate([V, V, V])
    dump(path, *again, steps=range(8))
    assert fault(path).startswith("has 8 whole frames")
    dump(path, *again, steps=range(9))
    assert "it has more than 8 frames; write it anew" in fault(path)
    assert not is_dump(tmp_path / "none")
    assert fault(tmp_path / "none") == "there is no such file"
    assert fault(tmp_path) == "is a folder; name the dump in it"
    name: Any
    for name in (None, 5, "a" * 300, "a\0b"):
        with pytest.raises(InputError, match=r"^path: "):
            Trajectory.from_dump(name, SCENE)
        with pytest.raises(InputError, match=r"^from: "):
            scene_of_run([name])


def test_invalid_numbers(tmp_path: Path):
    for field in (U, V):
        broken = field.copy()
        broken[2, 1] = np.nan
        path = dump(tmp_path / "run.dump", **{"u" if field is U else "v": broken})
        assert (
            fault(path)
            == "contains numbers that are not finite, from a breakdown: use a shorter step"
        )
    twice = dump(tmp_path / "run.dump", numbers=np.array([4, 1, 3, 3, 5]))
    assert "cannot be read as a dump: two atoms have the same number; write it anew" in fault(twice)
    high = dump(tmp_path / "run.dump", numbers=10**15 + NUMBERS)
    assert np.array_equal(Trajectory.from_dump(high, SCENE).displacement, U)
    higher = dump(tmp_path / "run.dump", numbers=2**53 + 2 * NUMBERS)
    assert "an atom has no valid number" in fault(higher)
    lines = dump(tmp_path / "run.dump").read_text().splitlines()
    lines[10] = ""
    (tmp_path / "run.dump").write_text("\n".join(lines) + "\n")
    assert "an atom has no line at step 100" in fault(tmp_path / "run.dump")
    twice = dump(tmp_path / "run.dump", numbers=np.array([4, 1, 3, 3, 5]))
    fewer = Scene(**SCENE.given() | {"chain": Chain(grains=4, diameter=1e-3)})
    assert (
        fault(twice, fewer)
        == "has 5 atoms, but the scene has 4 grains (step 100): give the scene that the dump was "
        "made for"
    )


def test_missing_columns(tmp_path: Path):
    path = tmp_path / "run.dump"
    assert fault(dump(path, columns="id x y z")).startswith(
        "has no column vz: dump custom ... id x y z vz v_phi"
    )
    assert fault(dump(path, columns="x y vz")).startswith("has no column id, z: ")
    assert fault(dump(path, columns="id xu yu vz")).startswith("has no column x, y, z: ")
    assert fault(dump(path, columns="id x y z vx")).startswith(
        "has no column vz, but its grains are in line along z: "
    )
    text = dump(path).read_text()
    path.write_text(text.replace("\n5\nITEM: BOX", "\nfive\nITEM: BOX"))
    assert fault(path) == "ITEM: NUMBER OF ATOMS must be a whole number (got five): write it anew"
    path.write_text(text.rpartition(" ")[0] + " high\n")
    assert "cannot be read as a dump" in fault(path)
    path.write_text(text[:-1])
    assert fault(path) == "is cut short within a line: run LAMMPS to its end"
    path.write_text("\n" + text)
    assert "is not a LAMMPS dump in text" in fault(path)


@pytest.mark.parametrize("angle", [0.1, 0.79, 0.81, 1.19, 3.0])
def test_motion_decides_at_any_sampling(tmp_path: Path, angle: float):
    """Durations of 0.5 and 1.5 times the true one are rejected, and wrong masses are.

    `angle` is half the phase of the fastest motion between two frames.
    """
    diameters = 1e-3 * (1 + 0.3 * (np.arange(12) % 3))
    chain = Chain(grains=12, diameter=diameters, gravity=0.0, top_load=0.1)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3, grain=5), duration=1e-5)
    scene = scene.replace(samples=31, duration=60 * angle / scene.highest_frequency)
    motion = simulate(scene, "native", tolerance=1e-9)
    rest = -np.append(0, np.cumsum(chain.contact_lengths[1:-1] - chain.equilibrium_overlap))
    fields = motion.displacement, motion.velocity, rest
    steps = range(0, 31000, 1000)
    for form in ("%.17g", "%.6g"):
        path = dump(tmp_path / "run", *fields, steps=steps, form=form, numbers=np.arange(12))
        assert Trajectory.from_dump(path, scene).grains.size == 12
        for factor in (0.5, 1.5):
            message = fault(path, scene.replace(duration=factor * scene.duration))
            assert message.startswith("its displacements change ")
            ratio = float(message.split()[3])
            # A lower duration resolves the motion better than the frames do.
            assert ratio == pytest.approx(1 / factor, rel=0.02 if angle < 0.2 else 0.5)
        heavier = scene.replace(chain=chain.replace(masses=1.5 * chain.masses))
        if angle < 1:
            assert fault(path, heavier).startswith("its accelerations are ")


@pytest.mark.parametrize("flags", [True, False])
def test_a_grain_that_crosses_a_periodic_box_needs_its_images(tmp_path: Path, flags: bool):
    u = U.copy()
    u[:, 0] = -U[:, 0]
    columns = f"id x y z vz{' ix iy iz' * flags}"
    path = dump(tmp_path / "run.dump", u=u, columns=columns)
    # The first frame has the uppermost grain just below the upper side of the box.
    top = REST[0] + 1e-10
    side = f"{top - 0.02:.17g} {top:.17g}"
    text = path.read_text().replace("ff ff ff", "ff ff pp")
    lines = text.replace("-1 1\nITEM: ATOMS", f"{side}\nITEM: ATOMS").splitlines()
    for number, line in enumerate(lines):
        words = line.split()
        if len(words) == len(columns.split()) and words[0] == str(NUMBERS[0]):
            over = float(words[3]) > top
            words[3] = f"{float(words[3]) - 0.02 * over:.17g}"
            words[5:] = ["0", "0", str(int(over))] * flags
            lines[number] = " ".join(words)
    path.write_text("\n".join(lines) + "\n")
    if flags:
        found = Trajectory.from_dump(path, SCENE).displacement
        np.testing.assert_allclose(found, u, rtol=0, atol=1e-17)
    else:
        assert fault(path).startswith("its positions z jump across the periodic box: dump xu yu zu")


@pytest.mark.parametrize(("share", "good"), [(0.49, True), (0.51, False)])
def test_the_axis_of_a_column_is_at_least_twice_as_long(tmp_path: Path, share: float, good: bool):
    path = dump(tmp_path / "run.dump", columns="id x y z vx vy vz v_phi")
    span = float(np.ptp(REST))
    lines = path.read_text().splitlines()
    lines[9] = lines[9].replace(" 0 0 ", f" {share * span!r} 0 ", 1)
    path.write_text("\n".join(lines) + "\n")
    if good:
        assert np.array_equal(Trajectory.from_dump(path, SCENE).displacement, U)
        return
    assert fault(path).endswith(
        "its grains are not in line along x, y or z: give the axis of the column"
    )
    assert np.array_equal(Trajectory.from_dump(path, SCENE, axis="z").displacement, U)


@pytest.mark.parametrize(("levels", "good"), [(101, True), (99, False)])
def test_heights_need_enough_digits(tmp_path: Path, levels: int, good: bool):
    """Heights are rounded to 1e-10 m, and the motion is a given multiple of that."""
    rest = np.round(REST, 10)
    u = np.zeros((SAMPLES, 5))
    u[:, 1] = np.array([0, 0.3, 0.7, 1.0]) * levels * 1e-10
    u = np.round(u, 10)
    path = dump(tmp_path / "run.dump", u=u, rest=rest, columns="id x y z vz", form="%.10f")
    path.write_text(path.read_text().replace("-0.0020000000", "-0.002"))
    scene = SCENE
    if good:
        t = Trajectory.from_dump(path, scene)
        np.testing.assert_allclose(t.displacement, u, rtol=0, atol=1e-17)
        shares = (
            "displacement within 5e-11 m, 0.005 of the largest; "
            "velocity within 5e-05 m/s, 0.03 of the largest"
        )
        assert t.provenance["precision"] == shares
        return
    why = fault(path, scene)
    assert why.startswith(
        "its heights have 8 digits, too few for displacements of 1e-08 m: write them with"
    )


def test_precise_numbers_are_recognised(tmp_path: Path):
    t = Trajectory.from_dump(dump(tmp_path / "run.dump", u=U * math.pi, v=V), SCENE)
    digit = np.spacing(U.max() * math.pi)
    within = t.provenance["precision"].split(";")[0]
    assert (
        within == f"displacement within {digit / 2:.2g} m, "
        f"{digit / 2 / (U.max() * math.pi):.1g} of the largest"
    )


# Speeds of seven grains from the top, and the grain that is held.
HELD = {
    "the lowest one, beside the wave": ([1, 1, 2, 1, 1, 1, 0], [7]),
    "both ends, beside the wave": ([0, 1, 2, 1, 1, 1, 0], [1, 7]),
    "the uppermost one, far from the strike": ([0, 0, 0, 0, 1, 0, 0], [1]),
    "the lowest one, far from the strike": ([0, 0, 1, 0, 0, 0, 0], [7]),
    "the end without motion": ([1, 1, 0, 0, 0, 0, 0], [7]),
    "the other end without motion": ([0, 0, 0, 0, 0, 1, 1], [1]),
    "none": ([1, 1, 1, 1, 1, 1, 1], []),
}


@pytest.mark.parametrize("name", HELD)
def test_the_grains_of_a_run_are_those_of_its_dump(tmp_path: Path, name: str):
    """Grains fly at given speeds for 2e-7 s a step; all numbers are read back."""
    speeds, held = HELD[name]
    numbers = np.array([4, 1, 3, 2, 5, 7, 6])
    v = 1e-3 * math.pi * np.array(speeds) * np.ones((SAMPLES, 1))
    u = 50 * 2e-7 * TIMES * v
    rest = -1e-3 * np.arange(7.0)
    steps = np.array([100, 150, 200, 250])
    more = {
        "radius": np.full((SAMPLES, 7), 5e-4),
        "mass": np.tile(1e-6 * numbers, (SAMPLES, 1)),
        "type": np.tile(1 + numbers % 2, (SAMPLES, 1)),
        "v_time": np.tile(2e-7 * steps[:, None], 7),
    }
    columns = "id type x y z vx vy vz radius mass v_time"
    path = dump(tmp_path / "run.dump", u, v, rest, columns, steps, numbers=numbers, more=more)
    path.write_text(path.read_text().replace("ff ff ff\n-1 1", "pp ff ff\n-1 2"))
    found = read_grains(path)
    assert found.numbers.tolist() == [1, 2, 3, 4, 5, 6, 7]
    back = np.argsort(numbers)
    np.testing.assert_array_equal(found.positions, np.outer(rest[back], [0, 0, 1]))
    np.testing.assert_array_equal(found.velocities, np.outer(v[0, back], [0, 0, -1]))
    assert set(found.numbers[found.held]) == {int(numbers[place - 1]) for place in held}
    assert found.types.tolist() == [2, 1, 2, 1, 2, 1, 2]
    np.testing.assert_array_equal(found.diameters, 1e-3)
    np.testing.assert_array_equal(found.masses, 1e-6 * np.arange(1, 8))
    assert found.duration == pytest.approx(150 * 2e-7, rel=1e-12)
    assert found.likely_step == pytest.approx(2e-7, rel=1e-6)
    assert found.period.tolist() == [3, math.inf, math.inf]
    assert (found.samples, found.steps) == (SAMPLES, (100, 250))
    assert not found.digits_lost
    assert 0 < found.slack < 1e-17
    short = read_grains(dump(path, u, v, rest, columns, steps, "%.8g", numbers=numbers, more=more))
    assert short.digits_lost
    assert short.slack == pytest.approx(2e-10, rel=1e-3)


def test_the_scene_of_a_dump_is_found(tmp_path: Path):
    more = {
        "radius": np.tile(CHAIN.diameters / 2, (SAMPLES, 1)),
        "mass": np.tile(CHAIN.masses, (SAMPLES, 1)),
        "v_time": np.tile(1e-4 * TIMES, 5),
    }
    columns = "id x y z vx vy vz radius mass v_time"
    path = dump(tmp_path / "run.dump", columns=columns, more=more)
    found = Scene(**scene_of_run([path], RunOptions(material="glass")).fields)
    assert found.excitation == SCENE.excitation
    assert found.duration == pytest.approx(SCENE.duration, rel=1e-12)
    assert found.chain.gravity == pytest.approx(9.81, rel=1e-6)
    assert found.chain.contact_constants == pytest.approx(CHAIN.contact_constants, rel=1e-6)
    assert found.chain.masses == pytest.approx(CHAIN.masses, rel=1e-6)
    assert Trajectory.from_dump(path, found).displacement == pytest.approx(U, rel=1e-6, abs=1e-17)


def test_runs_without_a_scene_are_refused(tmp_path: Path):
    moving = dump(tmp_path / "run.dump", v=V + 1e-3)
    for change, message in (
        ({"steps": [100]}, "has only one frame, and so no duration: dump two or more"),
        ({"steps": [0, 50, 100, 151]}, "its frames are not equally far apart"),
        ({"v": np.where(V == 2e-3, np.nan, V)}, "contains numbers that are not finite"),
        ({"v": V - V[0]}, "grains move, but not in the first frame: begin the dump"),
        ({"columns": "id x y z vx"}, "has no column vz, the velocity along the chain"),
        ({"more": {"x": 1e-9 * TIMES * np.ones(5)}}, "a grain moves sideways by 3e-09 m"),
    ):
        with pytest.raises(InputError) as error:
            read_grains(dump(tmp_path / "bad.dump", **change))
        assert str(error.value).startswith(f"{tmp_path / 'bad.dump'}: {message}"), message
    with pytest.raises(InputError, match=r"^from: must be a dump, an input or data file, or one"):
        scene_of_run([moving, moving])
    for path, message in ((tmp_path, "is a folder"), (tmp_path / "none", "there is no such file")):
        with pytest.raises(InputError, match=message):
            scene_of_run([path])
