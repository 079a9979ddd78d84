"""Foreign files are rejected before any of their content is opened."""

import hashlib
import io
import json
import os
import pickle
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numcodecs
import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck
from helpers.faults import faults
from helpers.seals import seal_anew
from numcodecs.abc import Codec

from lmpchain import InputError, Stopped, Trajectory, resume, simulate
from lmpchain.cli.command_line import main
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.report.document import origin
from lmpchain.simulation import folder_files
from lmpchain.util.files import seal

SCENE = struck(column(12, material="glass"), 1e-5, 2e-5, 41)


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a run in a file, in a run folder, and in an unfinished run folder."""
    folder = tmp_path_factory.mktemp("originals")
    simulate(SCENE, "native", folder=folder / "run").save(folder / "run.nc")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stepping_run, "BLOCK_S", 1e-9)  # Four samples per block.
        with pytest.raises(Stopped):
            simulate(SCENE, "native", folder=folder / "stopped", max_wall=1e-9)
    return folder


@pytest.fixture
def run_folder(originals: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(originals / "run", tmp_path / "run"))


@pytest.fixture
def stopped(originals: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(originals / "stopped", tmp_path / "stopped"))


def refused(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line with which all readers reject a file."""
    ((key, why),) = faults(Trajectory.load, path)
    assert key == str(path)
    capsys.readouterr()
    for words in (["fit", str(path)], ["report", str(path), "-o", str(path.parent / "new.html")]):
        assert main(words) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2, said
    assert all(line.startswith(f"error: {path}: ") for line in said)
    assert not (path.parent / "new.html").exists()
    return why


class Trap:
    """An object that leaves a mark when it is unpickled."""

    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str, bytes]]:
        return Path.write_bytes, (self.mark, b"")  # type: ignore[return-value]


class Unpickling(Codec):
    """The codec "pickle" of older versions of numcodecs, under another name."""

    codec_id = "lmpchain-test-pickle"

    def encode(self, buf: Any) -> bytes:
        return pickle.dumps(buf)

    def decode(self, buf: Any, out: Any = None) -> Any:
        return pickle.loads(bytes(buf))


numcodecs.register_codec(Unpickling)


def test_no_pickle_of_a_store_is_opened(run_folder: Path, capsys: pytest.CaptureFixture[str]):
    """The store of Zarr version 2 has a filter that executes the content of its chunks."""
    mark = run_folder.parent / "mark"
    store = run_folder / "trajectory.zarr"
    about = json.loads((store / "zarr.json").read_text())["attributes"]
    shutil.rmtree(store)
    store.mkdir()
    (store / ".zgroup").write_text('{"zarr_format": 2}')
    (store / ".zattrs").write_text(json.dumps(about))
    fields = {"displacement": (41, 12), "velocity": (41, 12), "time": (41,), "grain": (12,)}
    for name, shape in fields.items():
        layout = {"zarr_format": 2, "shape": shape, "chunks": shape, "dtype": "|O", "order": "C"}
        codecs = {"fill_value": None, "filters": [{"id": Unpickling.codec_id}], "compressor": None}
        (store / name).mkdir()
        (store / name / ".zarray").write_text(json.dumps(layout | codecs))
        dimensions = ["time", "grain"][: len(shape)]
        (store / name / ".zattrs").write_text(json.dumps({"_ARRAY_DIMENSIONS": dimensions}))
        (store / name / ".".join("0" * len(shape))).write_bytes(pickle.dumps(Trap(mark)))
    assert "Zarr format 3" in refused(run_folder, capsys)
    assert not mark.exists()


CODEC = {"name": "numcodecs.pickle", "configuration": {}}
CHANGES: dict[str, Callable[[dict[str, Any]], None]] = {
    "codec in a shard": lambda about: about["codecs"][0]["configuration"]["codecs"].append(CODEC),
    "objects": lambda about: about.update(data_type="object"),
    "shape": lambda about: about.update(shape=[10**9, 12]),
    "a list": lambda about: about.update(codecs=[[]]),
    "nothing": lambda about: about.clear(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_store_with_another_layout_is_rejected_unopened(
    run_folder: Path,
    change: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    """The metadata of an array and their copy in those of the group differ from lmpchain's."""
    import xarray
    import zarr

    store = run_folder / "trajectory.zarr"
    for path in (store / "velocity" / "zarr.json", store / "zarr.json"):
        about = json.loads(path.read_text())
        of_group = path.parent == store
        CHANGES[change](
            about["consolidated_metadata"]["metadata"]["velocity"] if of_group else about
        )
        path.write_text(json.dumps(about))
    for library, opening in ((xarray, "open_dataset"), (zarr, "open_group"), (zarr, "open_array")):
        monkeypatch.setattr(library, opening, lambda *_, **__: pytest.fail("it was opened"))
    refused(run_folder, capsys)


@pytest.mark.parametrize(
    "where", ["trajectory.zarr", "trajectory.zarr/velocity", "trajectory.zarr/velocity/c/0/0"]
)
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_nothing_outside_a_run_folder_is_read_or_written(
    run_folder: Path, where: str, kind: str, capsys: pytest.CaptureFixture[str]
):
    path = run_folder / where
    outside = run_folder.parent / "outside"
    os.rename(path, outside)
    before = {p: p.read_bytes() for p in outside.rglob("*") if p.is_file()}
    if kind == "link":
        path.symlink_to(outside)
    else:
        os.mkfifo(path)
    refused(run_folder, capsys)
    assert main(["resume", str(run_folder)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {run_folder}: ")
    assert before == {p: p.read_bytes() for p in outside.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    "name", ["run.json", "scene.toml", "status.json", "checkpoint", ".lock", "deck"]
)
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_run_is_not_resumed_through_links(
    stopped: Path, name: str, kind: str, capsys: pytest.CaptureFixture[str]
):
    path = stopped / name
    outside = stopped.parent / "outside"
    outside.write_bytes(path.read_bytes() if path.exists() else b"mine")
    before = outside.read_bytes()
    path.unlink(missing_ok=True)
    path.symlink_to(outside) if kind == "link" else os.mkfifo(path)
    assert main(["resume", str(stopped)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {stopped}: ")
    assert outside.read_bytes() == before


def test_a_run_folder_cannot_contain_commands(stopped: Path):
    """Commands of LAMMPS can start programs, so commands in a run folder are not executed."""
    mark = stopped.parent / "mark"
    path = stopped / "run.json"
    (stopped / "more.in").write_text(f"shell touch {mark}\n")
    asked = json.loads(path.read_text())
    for options, fault in (
        ({"include": str(stopped / "more.in")}, "has the command shell"),
        ({"include": f"shell touch {mark}\n"}, "has the command shell"),
        ({"include": f'print x "file" {mark}\n'}, "give a plain file name"),
        ({"template": str(stopped / "more.in")}, "leave it out in a run folder"),
    ):
        asked |= {"engine": "lammps", "options": options | {"integrator": "verlet", "step": 1e-7}}
        asked["sha256"] = folder_files.order_hash(asked, (stopped / "scene.toml").read_text())
        path.write_text(json.dumps(asked))
        with pytest.raises(InputError, match=fault):
            resume(stopped)
    assert not mark.exists()


# --- checkpoints: they contain their own hash, so that anybody can make one


def with_checkpoint(folder: Path, content: bytes) -> None:
    (folder / "checkpoint-before").unlink()
    (folder / "checkpoint").write_bytes(hashlib.sha256(content).digest() + content)


def arrays_of(folder: Path) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO((folder / "checkpoint").read_bytes()[32:])) as arrays:
        return dict(arrays)


def test_no_pickle_of_a_checkpoint_is_opened(stopped: Path):
    mark = stopped.parent / "mark"
    packed = io.BytesIO()
    np.savez(
        packed,
        notes=arrays_of(stopped)["notes"],
        **{"state.0.u": np.array([Trap(mark)], dtype=object)},
    )
    with_checkpoint(stopped, packed.getvalue())
    with pytest.warns(
        UserWarning, match="the newest checkpoint is damaged; going on from the start"
    ):
        assert np.array_equal(resume(stopped).velocity, simulate(SCENE, "native").velocity)
    assert not mark.exists()


@pytest.mark.parametrize("what", ["compressed", "huge", "not an archive"])
def test_an_invalid_checkpoint_is_not_used(stopped: Path, what: str):
    packed = io.BytesIO()
    arrays = arrays_of(stopped)
    if what == "compressed":
        np.savez_compressed(packed, **arrays)
    else:
        np.savez(packed, **arrays)
    if what == "huge":
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
        )
        with zipfile.ZipFile(packed, "a") as archive:
            archive.writestr("state.more.npy", header.getvalue())
    with_checkpoint(stopped, packed.getvalue() if what != "not an archive" else b"PK")
    with pytest.warns(
        UserWarning, match="the newest checkpoint is damaged; going on from the start"
    ):
        assert np.array_equal(resume(stopped).velocity, simulate(SCENE, "native").velocity)


@pytest.mark.parametrize("what", ["window", "shape", "sample", "lost", "none", "text"])
def test_the_state_of_a_checkpoint_must_match_its_run(stopped: Path, what: str):
    """The compiled loops do not check their array bounds, so a state is checked when it is read."""
    arrays = arrays_of(stopped)
    if what == "window":
        arrays["state.native.state"]["first"][0] = -(10**9)
    elif what == "shape":
        arrays["state.native.history"] = np.zeros((1, 9, 9))
    elif what == "sample":
        arrays["state.sample"] = np.array(3)
    elif what == "lost":
        del arrays["state.differences"]
    elif what == "none":
        del arrays["state.native.u"]
    else:
        arrays["state.native.u"] = np.array(["a"] * 12)
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    with_checkpoint(stopped, packed.getvalue())
    with pytest.raises(InputError, match="checkpoint: does not belong"):
        resume(stopped)


# --- HDF5


KINDS = [
    "link to another file", "link", "link to itself", "stored outside", "virtual", "huge",
    "not written", "packed", "text", "group", "longer chain", "chain in a file", "two scenes",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_only_plain_arrays_of_the_file_itself_are_read(
    originals: Path, tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
):
    outside, path = tmp_path / "outside.nc", tmp_path / "run.nc"
    for copy in (outside, path):
        shutil.copy(originals / "run.nc", copy)
    elsewhere = h5py.VirtualLayout((41, 12), "f8")
    elsewhere[:] = h5py.VirtualSource(outside, "velocity", (41, 12))
    links = {
        "link to another file": h5py.ExternalLink(outside, "/velocity"),
        "link": h5py.SoftLink("/displacement"),
        "link to itself": h5py.SoftLink("/velocity"),
    }
    arrays: dict[str, dict[str, Any]] = {
        "stored outside": {"external": [(str(outside), 0, h5py.h5f.UNLIMITED)]},
        "huge": {"shape": (41, 10**12)},
        "not written": {},
        "packed": {"data": np.zeros((41, 12)), "compression": "gzip"},
        "text": {"dtype": h5py.string_dtype()},
    }
    with h5py.File(path, "r+") as file:
        text = file.attrs["scene"]
        scenes: dict[str, Any] = {
            "longer chain": text.replace("grains = 12", "grains = 1000000"),
            "chain in a file": text.replace("grains = 12", f'file = "{outside}"'),
            "two scenes": np.array(["a", "b"], dtype=object),
        }
        if kind in scenes:
            file.attrs["scene"] = scenes[kind]
        else:
            del file["velocity"]
        if kind in links:
            file["velocity"] = links[kind]
        elif kind in arrays:
            file.create_dataset("velocity", **{"shape": (41, 12), "dtype": "f8"} | arrays[kind])
        elif kind == "virtual":
            file.create_virtual_dataset("velocity", elsewhere)
        elif kind == "group":
            file.create_group("velocity")
    seal_anew(path)
    assert "seal" not in refused(path, capsys)


def changed_bytes(content: bytes, seed: int) -> bytes:
    """Return the bytes of a file with some bytes changed, removed, repeated or inserted."""
    random = np.random.default_rng(seed)
    changed = bytearray(content)
    for _ in range(random.integers(1, 6)):
        place = int(random.integers(len(changed)))
        length = int(random.choice([1, 8, 64, 500]))
        how = random.choice(["bits", "lost", "doubled", "zeros", "cut"])
        if how == "bits":
            changed[place] ^= 1 << int(random.integers(8))
        elif how == "lost":
            del changed[place : place + length]
        elif how == "doubled":
            changed[place:place] = changed[place : place + length]
        elif how == "zeros":
            changed[place : place + length] = bytes(length)
        else:
            del changed[max(place, len(changed) // 4) :]
    return bytes(changed)


@pytest.mark.parametrize("seed", range(12))
def test_no_changed_file_reaches_the_hdf5_library(
    originals: Path, tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
):
    """HDF5 hung on two of 756 such files, and only a kill stopped it."""
    content = (originals / "run.nc").read_bytes()
    end = len(content) - len(seal(b""))
    reached = []
    monkeypatch.setattr(h5py, "File", lambda *words, **options: reached.append(words))
    path = tmp_path / "run.nc"
    changed = changed_bytes(content[:end], seed)
    more = content + bytes(seed + 1)
    for spoilt in (changed, changed + content[end:], content[: end + seed], more):
        path.write_bytes(spoilt)
        with pytest.raises(InputError, match="save it anew") as caught:
            Trajectory.load(path)
        assert str(caught.value).startswith(f"{path}: is not a trajectory that lmpchain saved")
        assert "\n" not in str(caught.value)
        assert origin(path)["command"] == "not recorded"
    assert not reached


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_special_files_are_rejected(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "run.nc"
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    refused(path, capsys)
