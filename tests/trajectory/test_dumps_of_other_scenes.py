"""Changed LAMMPS dumps, and dumps of other scenes: read correctly or rejected with a remedy."""

import gzip
import re
import tracemalloc
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.standalone_lammps import lmp
from helpers.taylor_series import reference
from helpers.thinned import thinned

from lmpchain import Chain, Force, Impulse, InputError, Scene, Trajectory
from lmpchain.cli import main
from lmpchain.engines.lammps.export import write_deck

GRAINS = 12
CHAIN = Chain(grains=GRAINS, material="glass", diameter=1e-3, top_load=0.02)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-4), duration=8e-6, samples=41)
# Columns of a dump without displacements.
OWN = "id x y z vz radius mass"
SIDE = 0.04  # Side of the box, m.


class Frame:
    """A frame of a dump that can be changed."""

    def __init__(self, text: str):
        lines = text.splitlines()
        self.above = ""  # Lines above the first line.
        self.step = lines[1]
        self.atoms = lines[3]
        self.box = lines[4:8]
        self.columns = lines[8].split()[2:]
        self.rows = [dict(zip(self.columns, line.split(), strict=True)) for line in lines[9:]]

    def change(self, column: str, law: Callable[[float], float]) -> None:
        """Change the numbers of a column."""
        for row in self.rows:
            row[column] = f"{law(float(row[column])):.17g}"

    def text(self) -> str:
        """Return the lines of the frame."""
        head = [f"{self.above}ITEM: TIMESTEP", self.step, "ITEM: NUMBER OF ATOMS", self.atoms]
        body = [" ".join(row[key] for key in self.columns) for row in self.rows]
        columns = "ITEM: ATOMS " + " ".join(self.columns)
        return "\n".join([*head, *self.box, columns, *body]) + "\n"


def frames_of(path: Path) -> list[Frame]:
    """Return the frames of a dump."""
    return [Frame("ITEM: TIMESTEP" + text) for text in path.read_text().split("ITEM: TIMESTEP")[1:]]


@pytest.fixture(scope="module")
def decks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return dumps of lmpchain's deck and of another deck, of one run."""
    folder = tmp_path_factory.mktemp("deck")
    include = folder / "own.include"
    include.write_text(
        f"dump own all custom 20 own.dump {OWN}\ndump_modify own sort id format float %.17g\n"
    )
    # There are 20 steps between two samples.
    write_deck(SCENE, folder, step=1e-8, include=include, diameter="physical")
    lmp(folder)
    return {"ours": folder / "column.lammpstrj", "own": folder / "own.dump"}


@pytest.fixture(scope="module", params=["ours", "own"])
def original(request: pytest.FixtureRequest, decks: dict[str, Path]) -> Path:
    return decks[request.param]


def write(path: Path, frames: list[Frame]) -> Path:
    path.write_text("".join(frame.text() for frame in frames))
    return path


def refused(path: Path, scene: Scene, says: str) -> None:
    """Assert that a dump is rejected in one line with the fault and the remedy."""
    with pytest.raises(InputError, match=says) as caught:
        Trajectory.from_dump(path, scene)
    assert str(caught.value).count("\n") == 0
    assert re.search(r": (give|set|dump|run|write|use) ", str(caught.value))


# --- changed dumps


def scaled(columns: str, factor: float) -> Callable[[list[Frame]], None]:
    def change(frames: list[Frame]) -> None:
        for frame in frames:
            for column in columns.split():
                if column in frame.columns:
                    frame.change(column, lambda value: factor * value)

    return change


def every(number: int) -> Callable[[list[Frame]], None]:
    """Return a function that keeps every n-th frame of a dump."""

    def change(frames: list[Frame]) -> None:
        frames[:] = frames[::number]

    return change


def later_columns(frames: list[Frame]) -> None:
    for frame in frames[7:]:
        frame.columns[2:4] = frame.columns[3:1:-1]


def fewer_columns(frames: list[Frame]) -> None:
    for frame in frames[7:]:
        del frame.columns[-1]


def timed(interval: float, units: str = "si", start: float = 0.0) -> Callable[[list[Frame]], None]:
    """Return dumps as `dump_modify units yes time yes` writes them."""

    def change(frames: list[Frame]) -> None:
        for number, frame in enumerate(frames):
            frame.above = f"ITEM: TIME\n{start + number * interval:.16g}\n"
        frames[0].above = f"ITEM: UNITS\n{units}\n{frames[0].above}"

    return change


def odd_times(frames: list[Frame]) -> None:
    timed(2e-7)(frames)
    frames[9].above = "ITEM: TIME\nnoon\n"


def lost_time(frames: list[Frame]) -> None:
    timed(2e-7)(frames)
    frames[9].above = ""


def uneven_times(frames: list[Frame]) -> None:
    timed(2e-7)(frames)
    frames[9].above = f"ITEM: TIME\n{9.5 * 2e-7!r}\n"


def wrapped(flags: bool, lowest: float) -> Callable[[list[Frame]], None]:
    """Return dumps of a box that is periodic along z and begins at a given height."""

    def change(frames: list[Frame]) -> None:
        for frame in frames:
            frame.box = ["ITEM: BOX BOUNDS ff ff pp", "-1 1", "-1 1", f"{lowest} {lowest + SIDE}"]
            if flags:
                frame.columns = [*frame.columns, "ix", "iy", "iz"]
            for row in frame.rows:
                image = np.floor((float(row["z"]) - lowest) / SIDE)
                row["z"] = f"{float(row['z']) - SIDE * image:.17g}"
                row |= {"ix": "0", "iy": "0", "iz": f"{image:.0f}"}

    return change


def unwrapped(frames: list[Frame]) -> None:
    for frame in frames:
        frame.columns = [*frame.columns, "xu", "yu", "zu"]
        for row in frame.rows:
            row |= {f"{key}u": row[key] for key in "xyz"}
    wrapped(flags=False, lowest=-0.0056)(frames)


def tilted(frames: list[Frame]) -> None:
    for frame in frames:
        frame.box = ["ITEM: BOX BOUNDS xy xz yz pp pp pp", "-1 1 0", "-1 1 0.5", "-1 1 0"]


def words_in_box(frames: list[Frame]) -> None:
    frames[3].box[3] = "low high"


def set_line(name: str, value: str, number: int = 0) -> Callable[[list[Frame]], None]:
    def change(frames: list[Frame]) -> None:
        setattr(frames[number], name, value)

    return change


def one_more(frames: list[Frame]) -> None:
    """Give a grain the height of another one, plus a difference."""
    frames[0].rows[4]["z"] = f"{float(frames[0].rows[4]['z']) + 1e-4:.17g}"


COUNT = r"ITEM: NUMBER OF ATOMS must be a whole number"
# Each change of the frames, and the message; empty if the dump is read unchanged.
CHANGES: dict[str, tuple[Callable[[list[Frame]], None], str]] = {
    "as it was": (lambda frames: None, ""),
    "micrometres": (scaled("x y z", 1e6), "grains 1 and 2 are .* m apart .* in units si"),
    "velocities in mm/s": (scaled("vz", 1e3), "grain 1 begins with a velocity of 0.1 m/s"),
    "velocities upward": (scaled("vz", -1), "grain 1 begins with a velocity of -0.0001 m/s"),
    "a little larger": (scaled("z radius", 1.0001), r"grains \d+ and \d+ (are|overlap)"),
    "one grain elsewhere": (one_more, r"grains \d+ and \d+ are 0.00"),
    "later columns": (later_columns, "ITEM: ATOMS names other columns at step 140 than in"),
    "fewer columns": (fewer_columns, "ITEM: ATOMS names other columns at step 140 than in"),
    "other order": (lambda frames: [f.columns.reverse() for f in frames] and None, ""),
    "with its times": (timed(2e-7), ""),
    "with later times": (timed(2e-7, start=3.0), ""),
    "with times of half the length": (timed(1e-7), "1e-07 s apart by .* scene are 2e-07"),
    "with times a little longer": (timed(2.001e-7), "apart by ITEM: TIME.*set the duration of"),
    "with a word as time": (odd_times, "ITEM: TIME must be a number of seconds .got noon."),
    "with a time lost": (lost_time, "by ITEM: TIME"),
    "with uneven times": (uneven_times, "by ITEM: TIME"),
    "in units cgs": (timed(2e-7, units="cgs"), "grains 1 and 2 are .* m apart"),
    "wrapped with flags": (wrapped(flags=True, lowest=-0.0056), ""),
    "wrapped often, with flags": (wrapped(flags=True, lowest=0.0844), ""),
    "not wrapped, with flags": (wrapped(flags=True, lowest=-0.03), ""),
    "wrapped": (wrapped(flags=False, lowest=-0.0056), "m apart .*dump .* xu yu zu"),
    "unwrapped": (unwrapped, ""),
    "tilted": (tilted, "ITEM: BOX BOUNDS must have two numbers in each line"),
    "words in the box": (words_in_box, "ITEM: BOX BOUNDS must have two numbers in each line"),
    "superscripts": (set_line("atoms", "\N{SUPERSCRIPT TWO}"), COUNT),
    "thousands of digits": (set_line("atoms", "1" * 5000), COUNT),
    "no steps": (set_line("step", "first", 3), "ITEM: TIMESTEP must be a whole number .got first"),
    "half of the frames": (every(2), "21 whole frames.*samples = 21, duration = 4e-06"),
}


# Units of length, time, mass and velocity in SI, by the tables of LAMMPS and CODATA.
STYLES = {
    "cgs": (1e-2, 1.0, 1e-3, 1e-2),
    "micro": (1e-6, 1e-6, 1e-15, 1.0),
    "nano": (1e-9, 1e-9, 1e-21, 1.0),
    "metal": (1e-10, 1e-12, 1.66053906660e-27, 1e2),
    "real": (1e-10, 1e-15, 1.66053906660e-27, 1e5),
    "electron": (5.29177210903e-11, 1e-15, 1.66053906660e-27, 5.29177210903e-11 / 1.03275e-15),
    "lj": (1e-3, 1e-6, 1e-9, 1e3),
}


@pytest.mark.parametrize(("style", "said"), thinned(product(STYLES, [True, False]), 3))
def test_dumps_in_other_units_are_converted(original: Path, style: str, said: bool, tmp_path: Path):
    length, time, mass, velocity = STYLES[style]
    frames = frames_of(original)
    timed(2e-7 / time, units=style)(frames)
    if not said:
        frames[0].above = frames[0].above.partition(f"{style}\n")[2]
    lengths = "x y z xu yu zu v_phi radius diameter"
    columns = ((lengths, length), ("vz", velocity), ("v_time", time), ("mass", mass))
    for names, unit in columns:
        scaled(names, 1 / unit)(frames)
    path = write(tmp_path / "changed.dump", frames)
    scales = (length, time, mass)
    units = scales if style == "lj" else None if said else style
    t = Trajectory.from_dump(path, SCENE, units=units)
    truth = Trajectory.from_dump(original, SCENE)
    # Heights of 12 mm have rounding errors from the conversion.
    for field, rounding in (("displacement", 4 * np.spacing(0.012)), ("velocity", 0.0)):
        close = 1e-9 * np.abs(getattr(truth, field)).max() + rounding
        assert getattr(t, field) == pytest.approx(getattr(truth, field), rel=0.0, abs=close)
    if said and style != "lj":
        with pytest.raises(InputError, match=f"units: si contradicts .*, {style}"):
            Trajectory.from_dump(path, SCENE, units="si")


def test_invalid_units(original: Path):
    for units, fault in (
        ("lj", "lj has no scale: give its units of length, time and mass"),
        ("imperial", "must be lj . si"),
        ("1,2,x", "above 0 .got '1,2,x'"),
        ((1e-3, 0.0, 1.0), "above 0"),
    ):
        with pytest.raises(InputError, match=f"units: .*{fault}"):
            Trajectory.from_dump(original, SCENE, units=units)


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_dump_is_read_unchanged_or_rejected(original: Path, name: str, tmp_path: Path):
    change, says = CHANGES[name]
    truth = Trajectory.from_dump(original, SCENE)
    frames = frames_of(original)
    change(frames)
    path = write(tmp_path / "changed.dump", frames)
    if says:
        # A deck of lmpchain has a separate column of displacements.
        if name == "velocities upward" and "own" in original.name:
            says = "grain 12 begins with a velocity|" + says
        refused(path, SCENE, says)
        return
    t = Trajectory.from_dump(path, SCENE)
    scale = np.abs(truth.displacement).max()
    assert np.abs(t.displacement - truth.displacement).max() < 1e-7 * scale
    assert np.array_equal(t.velocity, truth.velocity)


def test_the_precision_is_that_of_the_file(decks: dict[str, Path], tmp_path: Path):
    """Digits that box lengths add to positions are not digits of the dump."""
    frames = frames_of(decks["own"])
    wrapped(flags=True, lowest=0.0844)(frames)
    for frame in frames:
        for row in frame.rows:
            row["z"] = f"{float(row['z']):.8g}"
    refused(write(tmp_path / "dump", frames), SCENE, r"its heights have \d+ digits, too few for")


# --- dumps of another scene


def other(chain: dict[str, Any] | None = None, **scene: Any) -> Scene:
    """Return the scene with another chain or recording."""
    return SCENE.replace(chain=Chain(**CHAIN.given() | (chain or {})), **scene)


SCENES: dict[str, tuple[Scene, str]] = {
    "steel": (other({"material": "steel"}), "overlap by|forces of the scene"),
    "a little denser": (
        other({"material": {"density": 2450.0, "youngs_modulus": 62e9, "poissons_ratio": 0.2}}),
        "overlap by .* with its diameter, material, load and gravity|has a mass of",
    ),
    "a little stiffer": (
        other({"material": {"density": 2426.0, "youngs_modulus": 62.1e9, "poissons_ratio": 0.2}}),
        "overlap by .* with its diameter, material, load and gravity",
    ),
    "a little larger": (other({"diameter": 1.001e-3}), "m apart in the first frame"),
    "one larger": (other({"diameter": [1e-3] * 5 + [1.02e-3] + [1e-3] * 6}), "grains 5 and 6 are"),
    "a little more load": (other({"top_load": 0.0202}), "grains 1 and 2 overlap by"),
    "one heavier": (other({"masses": [4e-06, *CHAIN.masses[1:].tolist()]}), "overlap by"),
    "another exponent": (other({"exponent": 1.4}), "overlap by"),
    "half the duration": (
        other(duration=4e-6),
        "change 2 times .* 1e-07 s, the sampling|2e-07 s apart by .* scene are 1e-07",
    ),
    "twice the duration": (
        other(duration=16e-6),
        "change 0.5 times .* 4e-07 s, the sampling|2e-07 s apart by .* 4e-07",
    ),
    "a hundredth longer": (
        other(duration=8.08e-6),
        "change 0.99 times .* give the scene|apart by .* v_time",
    ),
    "more samples": (other(samples=81), "41 whole frames, but the scene has 81 samples over"),
    "another speed": (
        other(excitation=Impulse(velocity=2e-4)),
        "grain 1 begins with a velocity of 0.0001 m/s, but with 0.0002 in the scene: give",
    ),
    "another grain, faster": (
        other(excitation=Impulse(velocity=2e-4, grain=5)),
        "grain 5 begins with a velocity of 0 m/s, but with 0.0002 in the scene; grain 1 begins",
    ),
    "more grains": (other({"grains": 13}), "has 12 atoms, but the scene has 13 grains"),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_dump_read_as_another_scene_is_rejected(original: Path, name: str):
    refused(original, *SCENES[name])


@pytest.mark.parametrize("key", ["mass", "radius"])
def test_masses_and_radii_are_those_of_the_chain(decks: dict[str, Path], key: str, tmp_path: Path):
    frames = frames_of(decks["own"])
    frames[0].rows[3][key] = f"{float(frames[0].rows[3][key]) * 1.0001:.17g}"
    path = write(tmp_path / "dump", frames)
    refused(path, SCENE, f"grain 4 has a {key} of .*, but .* in the scene: give the scene")
    for frame in frames:
        for row in frame.rows:
            row["mass"] = f"{CHAIN.masses[0]:g}"
            row["radius"] = "0.0005"
    assert np.isfinite(Trajectory.from_dump(write(path, frames), SCENE).velocity).all()


# --- decks run with other options


OTHER_VARIABLES = {
    "-var dt 5e-9": "frames are 1e-07 s apart by",
    "-var dt 2e-8": "frames are 4e-07 s apart by",
    "-var every 10": "frames are 1e-07 s apart by",
    "-var every 60": "frames are 6e-07 s apart by",
    "-var dt 5e-9 -var every 40": "",
    "-var samples 20": "21 whole frames",
    "-var v0 2e-4": "velocity of 0.0002 m/s, but with 0.0001",
}


@pytest.mark.parametrize(
    ("diameter", "options"), thinned(product(["physical", "gauge"], OTHER_VARIABLES), 4)
)
def test_a_deck_that_is_run_with_other_variables(tmp_path: Path, diameter: str, options: str):
    says = OTHER_VARIABLES[options]
    write_deck(SCENE, tmp_path, step=1e-8, diameter=diameter)
    lmp(tmp_path, *options.split())
    path = tmp_path / "column.lammpstrj"
    if not says:
        assert Trajectory.from_dump(path, SCENE).cost.steps == 1600
    else:
        refused(path, SCENE, says)


@pytest.mark.parametrize("integrator", ["verlet", "kahan-li6"])
def test_a_deck_states_times_that_samples_do_not_show(tmp_path: Path, integrator: str):
    """The phase of the fastest motion between two samples is 10 rad."""
    scene = SCENE.replace(duration=2e-5, samples=5)
    write_deck(scene, tmp_path, step=1e-7, integrator=integrator)
    lmp(tmp_path)
    path = tmp_path / "column.lammpstrj"
    assert np.isfinite(Trajectory.from_dump(path, scene).velocity).all()
    longer = scene.replace(duration=2.2e-5)
    refused(
        path, longer, "5e-06 s apart by .* scene are 5.5e-06 s apart: set the duration .* to 2e-05"
    )


@pytest.mark.parametrize("load", [0.01, 0.024, 0.04])
def test_a_deck_with_a_gauge_diameter_has_the_forces_of_the_scene(tmp_path: Path, load: float):
    """Distances between such grains do not show the load, but the motion does."""
    scene = other({"gravity": 0.0}, duration=8e-6)
    write_deck(scene, tmp_path, step=1e-8, diameter="gauge")
    lmp(tmp_path)
    path = tmp_path / "column.lammpstrj"
    assert np.isfinite(Trajectory.from_dump(path, scene).velocity).all()
    refused(path, other({"gravity": 0.0, "top_load": load}), "accelerations are .* times as large")


@pytest.mark.parametrize("amplitude", [1e-6, 1e-5])
def test_grains_that_move_by_less_than_a_digit_of_their_height(tmp_path: Path, amplitude: float):
    """A grain beside a forced grain in a vacuum moves by less than a digit of its height."""
    chain = Chain(grains=GRAINS, diameter=1e-3, gravity=0.0)
    push = Force(grain=4, shape="half-sine", amplitude=amplitude, duration=5e-7)
    scene = Scene(chain=chain, excitation=push, duration=1e-6, samples=41)
    write_deck(scene, tmp_path, step=1.25e-9)
    lmp(tmp_path, "-var", "dump", "small.dump.gz")
    u = Trajectory.from_dump(tmp_path / "small.dump.gz", scene).displacement[:, 3]
    phase = np.pi * scene.time / 5e-7
    length = amplitude / chain.masses[3] * (5e-7 / np.pi) ** 2
    alone = length * np.where(phase < np.pi, phase - np.sin(phase), 2 * phase - np.pi)
    np.testing.assert_allclose(u, alone, rtol=0, atol=1e-3 * alone[-1])


@pytest.mark.parametrize("damping", [{"viscoelastic": 3e-7}, {"drag": 1e6}])
def test_a_dump_of_a_damped_chain(tmp_path: Path, damping: dict[str, float]):
    scene = other({"damping": damping})
    write_deck(scene, tmp_path, step=1e-8)
    lmp(tmp_path)
    path = tmp_path / "column.lammpstrj"
    t = Trajectory.from_dump(path, scene)
    true, doubt = reference(scene, 1e-12)
    assert true.error(t.displacement, t.velocity) + doubt < 0.01
    refused(path, scene.replace(duration=8.8e-6), "apart by .* v_time")


# --- files that exhaust the memory


def test_a_long_line_needs_no_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "dump.gz"
    path.write_bytes(gzip.compress(b"ITEM: TIMESTEP\n" + b"0" * 2**27, 1))
    tracemalloc.start()
    refused(path, SCENE, "has a line of more than 16384 characters: write it anew")
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()
    SCENE.to_toml(tmp_path / "scene.toml")
    assert main(["fit", str(path), "--scene", str(tmp_path / "scene.toml")]) == 2
    assert "Traceback" not in capsys.readouterr().err
