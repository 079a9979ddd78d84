"""Modified results of sweeps are rejected in one line before any file is opened."""

import json
import os
import pickle
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_sweeps import SCENE

from lmpchain import InputError, load_sweep, sweep
from lmpchain.sweeps.store import part_of, write_part

ASKED = {
    "scene": SCENE,
    "grid": {"chain.gravity": [1.0, 2.0, 3.0]},
    "keep": ["velocity", "wall_force"],
}
SHARDS = "codecs", 0, "configuration"
INNER = (*SHARDS, "codecs")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Return the folder of a sweep."""
    folder = tmp_path_factory.mktemp("trust") / "sweep"
    sweep(ASKED, folder)
    return folder


@pytest.fixture
def folder(tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of the folder with a store that must not be opened."""
    import zarr

    def opened(*_: Any, **__: Any) -> None:
        raise AssertionError("the store was opened")

    shutil.copytree(whole, tmp_path / "sweep")
    monkeypatch.setattr(zarr, "open_group", opened)
    return tmp_path / "sweep"


def results(folder: Path) -> Path:
    (found,) = folder.glob("*/results.zarr")
    return found.parent


def changed(name: str, *path: Any, to: Any) -> Callable[[Path], None]:
    """Return a function that changes a value in the metadata of an array."""

    def change(folder: Path) -> None:
        file = results(folder) / "results.zarr" / name / "zarr.json"
        about = json.loads(file.read_text())
        inside = about
        for key in path[:-1]:
            inside = inside[key]
        inside[path[-1]] = to
        file.write_text(json.dumps(about))

    return change


def link(name: str) -> Callable[[Path], None]:
    """Return a function that replaces a file by a link to a copy elsewhere."""

    def change(folder: Path) -> None:
        file = results(folder) / name if name else folder / "sweep.json"
        file.rename(folder.parent / "elsewhere")
        file.symlink_to(folder.parent / "elsewhere")

    return change


def pipe(name: str) -> Callable[[Path], None]:
    """Return a function that replaces a file by a pipe, which would block a reader."""

    def change(folder: Path) -> None:
        file = results(folder) / name if name else folder / "sweep.json"
        file.unlink(missing_ok=True)
        os.mkfifo(file)

    return change


def named(name: str) -> Callable[[Path], None]:
    """Return a function that makes the index refer to other results."""

    def change(folder: Path) -> None:
        index = json.loads((folder / "sweep.json").read_text())
        (folder / "sweep.json").write_text(json.dumps(index | {"results": name}))

    return change


def asking(**more: Any) -> Callable[[Path], None]:
    """Return a function that changes the stored sweep of the results."""

    def change(folder: Path) -> None:
        file = results(folder) / "sweep.json"
        file.write_text(json.dumps(json.loads(file.read_text()) | more))

    return change


def older(folder: Path) -> None:
    """Convert an array to Zarr version 2 with a filter that executes code when it is read."""
    array = results(folder) / "results.zarr" / "wall_force"
    shutil.rmtree(array)
    array.mkdir()
    about = {
        "zarr_format": 2,
        "shape": [3],
        "chunks": [3],
        "dtype": "|O",
        "fill_value": None,
        "order": "C",
    }
    (array / ".zarray").write_text(
        json.dumps(about | {"compressor": None, "filters": [{"id": "pickle"}]})
    )
    (array / "0").write_bytes(pickle.dumps(np.zeros(3, dtype=object)))


SEALED = "coordinates or descriptions were changed"
WAY = "wall_force is stored in a way that lmpchain does not use"
CHUNKS = "wall_force has chunks that lmpchain does not use"
CODECS = "it is stored with codecs that lmpchain does not use"
METADATA: list[tuple[tuple[Any, ...], Any, str]] = [  # Place, another value, and the fault.
    (("node_type",), "group", WAY),
    (("storage_transformers",), [{"name": "other"}], WAY),
    (("extension",), {}, WAY),
    (("data_type",), "object", "has a type of data that lmpchain does not use"),
    (("data_type",), "int64", CHUNKS),
    (("fill_value",), 0.0, CHUNKS),
    (("shape",), [10**12], SEALED),
    (("shape",), [], "has a shape that lmpchain does not use"),
    (("shape",), [-3], "has a shape that lmpchain does not use"),
    (("shape",), ["3"], "has a shape that lmpchain does not use"),
    (("shape",), [3, 3], "has a shape that lmpchain does not use"),
    (("attributes",), {"units": {}, "long_name": ""}, "has labels that lmpchain does not use"),
    (("dimension_names",), ["scene", "scene"], "has a shape that lmpchain does not use"),
    (("dimension_names",), [3], "has labels that lmpchain does not use"),
    (("chunk_key_encoding", "configuration", "separator"), "../", CHUNKS),
    (("chunk_grid", "configuration", "chunk_shape"), [10**9], SEALED),
    (("chunk_grid", "name"), "other", CHUNKS),
    ((*SHARDS, "chunk_shape"), [0], CHUNKS),
    ((*SHARDS, "index_location"), "start", "its shards differ from those that lmpchain writes"),
    (INNER, [{"name": "numcodecs.pickle"}], CODECS),
    ((*INNER, 1, "name"), "numcodecs.zlib", CODECS),
    ((*INNER, 1, "configuration", "strange"), 1, "its codecs have options that lmpchain does not"),
]


@pytest.mark.parametrize(("place", "value", "fault"), METADATA)
def test_metadata_not_written_by_lmpchain_are_named(
    folder: Path, place: tuple[Any, ...], value: Any, fault: str
) -> None:
    changed("wall_force", *place, to=value)(folder)
    with pytest.raises(InputError, match=rf"results\.zarr: is damaged \(.*{fault}"):
        load_sweep(folder)


@pytest.mark.parametrize(
    "tamper",
    [
        older,
        changed("wall_force", "zarr_format", to=2),
        changed("velocity", "shape", to=[3, 5, 6]),
        changed("reason", "data_type", to="float64"),
        changed("grain", "shape", to=[10**10]),
        changed("grain", "codecs", to=[{"name": "numcodecs.pickle"}]),
        changed("chain.gravity", "data_type", to="variable_length_bytes"),
        changed("", "attributes", "batch", to=-1),
        changed("", "attributes", "batch", to=2),
        changed("", "node_type", to="array"),
        link(""),
        link("sweep.json"),
        link("results.zarr/zarr.json"),
        link("results.zarr/wall_force/zarr.json"),
        link("results.zarr/wall_force/c/0"),
        link("results.zarr/wall_force"),
        link("results.zarr"),
        pipe(""),
        pipe("sweep.json"),
        pipe("results.zarr/wall_force/zarr.json"),
        pipe("results.zarr/wall_force/c/0"),
        pipe("parts/0000000.npz"),
        named(".."),
        named("."),
        named("../sweep"),
        named("/etc"),
        asking(scene="/etc/hostname"),
        asking(keep=["velocity"]),
        asking(keep=["velocity", "wall_force", "arrival_time"]),
        asking(grid={"chain.gravity": [1.0, 2.0]}),
        asking(files=None, scene=None),
        lambda folder: (results(folder) / "results.zarr" / "strange").mkdir(),
        lambda folder: (results(folder) / "results.zarr" / "strange").touch(),
        lambda folder: shutil.copytree(
            *(results(folder) / "results.zarr" / name for name in ("grain", "strange"))
        ),
        lambda folder: (results(folder) / "results.zarr" / "wall_force" / "zarr.json").write_text(
            "[" * 10**5
        ),
    ],
)
def test_stores_not_written_by_lmpchain_are_not_opened(folder, tamper):
    tamper(folder)
    with pytest.raises(InputError) as caught:
        load_sweep(folder)
    assert len(caught.value.faults) == 1
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "tamper", [link("sweep.json"), pipe("parts/0000000.npz"), asking(scene={})]
)
def test_modified_results_are_not_continued(folder, tamper):
    tamper(folder)
    with pytest.raises(InputError, match="is damaged"):
        sweep(ASKED, folder)


def test_a_lock_may_not_be_a_link(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / ".lock").symlink_to(tmp_path / "precious")
    with pytest.raises(InputError, match="is not a lock of lmpchain, but a link"):
        sweep(ASKED, tmp_path / "sweep")
    assert (tmp_path / "precious").read_text() == "precious"


class Trap:
    """An object that leaves a mark when it is unpickled."""

    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self) -> Any:
        return Path.touch, (self.mark,)


@pytest.mark.parametrize("how", ["pickle", "compressed", "too small", "whole"])
def test_parts_contain_plain_numbers(tmp_path, whole, how):
    """Parts are not unpickled, and may not be larger than their file."""
    shutil.copytree(whole, tmp_path / "sweep")
    mine = results(tmp_path / "sweep")
    shutil.rmtree(mine / "results.zarr" / "reason" / "c")
    mark = tmp_path / "mark"
    force = np.array([1.0, 2.0, 3.0])
    parts: dict[str, Any] = {
        "reason": np.array(["", "", ""]),
        "wall_force": force,
        "wall_force_error": force,
    }
    parts |= {"solver_error": force, "model_error": force, "velocity": np.zeros((3, 3, 6))}
    write_part(mine, 0, parts)
    if how == "pickle":
        np.savez(
            part_of(mine, 0),
            **parts | {"wall_force": np.array([Trap(mark)] * 3)},
            allow_pickle=True,
        )
    elif how == "compressed":
        np.savez_compressed(part_of(mine, 0), **parts)
    elif how == "too small":
        header = (
            b"\x93NUMPY\x01\x00v\x00"
            b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }"
        )
        with zipfile.ZipFile(part_of(mine, 0), "a") as packed:
            packed.writestr("wall_force.npy", header.ljust(127) + b"\n")
    if how == "whole":
        assert load_sweep(tmp_path / "sweep").wall_force.values.tolist() == force.tolist()
        return
    with pytest.raises(InputError, match="cannot be read"):
        load_sweep(tmp_path / "sweep").wall_force.load()
    assert not mark.exists()
