"""Results of a sweep count as done only after they are complete and on disk."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_sweeps import SCENE
from helpers.thinned import thinned

from lmpchain import InputError, load_sweep, sweep
from lmpchain.cli.command_line import main
from lmpchain.sweeps import store, tasks

ASKED = {
    "scene": SCENE,
    "grid": {"chain.gravity": [1.0, 2.0, 2.5, 3.0, 4.0]},
    "keep": ["velocity", "peak_force:2"],
}
SHARDS = 3


@pytest.fixture(scope="module", autouse=True)
def small_shards() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tasks, "TASKS", tasks.TASKS._replace(scenes=2))
        patch.setattr(store, "STORE", store.STORE._replace(shard_bytes=288))
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "sweep"
    sweep(ASKED, folder)
    assert len(list(folder.glob("*/shards/*.json"))) == SHARDS
    return folder


@pytest.fixture(scope="module")
def right(whole: Path) -> Any:
    return load_sweep(whole).load()


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole, tmp_path / "sweep")


def remove(path: Path) -> None:
    path.unlink()


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def zeros(path: Path) -> None:
    """Truncate content like a power cut: the length is on disk, but the content is zeros."""
    path.write_bytes(bytes(path.stat().st_size))


DAMAGE = remove, empty, cut, zeros
STORED = [
    "reason/c/1",
    "velocity/c/1/0/0",
    "peak_force_2/c/0",
    "peak_force_2_error/c/2",
    "solver_error/c/0",
    "chain.gravity/c/0",
    "time/c/0",
    "grain/c/0",
    "velocity/zarr.json",
    "zarr.json",
]


@pytest.mark.parametrize(("damage", "name"), thinned(product(DAMAGE, STORED), 13))
def test_incomplete_results_are_computed_again(
    name: str, damage: Callable[[Path], None], folder: Path, right: Any
):
    """Incomplete results count as missing or damaged, never as zeros or as results."""
    name = name.replace("peak_force_2", right_name(folder))
    (path,) = folder.glob(f"*/results.zarr/{name}")
    damage(path)
    meanwhile = loaded(folder)
    if isinstance(meanwhile, str):
        assert "sweep again" in meanwhile
        assert "\n" not in meanwhile
    else:
        lost = (meanwhile.reason == "not done").to_numpy()
        assert lost.any()
        assert np.isnan(meanwhile.velocity.to_numpy()[lost]).all()
        kept = right.isel({"chain.gravity": ~lost})
        assert meanwhile.isel({"chain.gravity": ~lost}).identical(kept)
    assert sweep(ASKED, folder).load().identical(right)
    assert load_sweep(folder).load().identical(right)


def loaded(folder: Path) -> Any:
    """Return the results in a folder, or the error line that rejects them."""
    try:
        return load_sweep(folder).load()
    except InputError as error:
        return str(error)


def right_name(folder: Path) -> str:
    (path,) = folder.glob("*/results.zarr/peak_force*2")
    return path.name


@pytest.mark.parametrize(
    ("name", "damage"),
    thinned(product(["shards/0000001.json", "store.json", "sweep.json"], DAMAGE), 5),
)
def test_incomplete_seals_and_tasks(
    name: str, damage: Callable[[Path], None], folder: Path, right: Any
):
    (path,) = folder.glob(f"*/{name}")
    damage(path)
    if name == "sweep.json" and damage is not remove:
        # The sweep of these results is unknown.
        with pytest.raises(InputError, match=r"is damaged .* remove it, and sweep again"):
            sweep(ASKED, folder)
        shutil.rmtree(path.parent)
    assert sweep(ASKED, folder).load().identical(right)


@pytest.mark.parametrize("damage", thinned([zeros, empty, cut], 3))
def test_an_incomplete_part_is_computed_again(
    damage: Callable[[Path], None], tmp_path: Path, right: Any, monkeypatch: pytest.MonkeyPatch
):
    from lmpchain.sweeps import run

    with monkeypatch.context() as patch:
        patch.setattr(run, "join_parts", None)
        with pytest.warns(UserWarning, match="could not be solved"):
            sweep(ASKED, tmp_path / "sweep")
    damage(next((tmp_path / "sweep").glob("*/parts/0000002.npz")))
    with pytest.raises(InputError, match="sweep again"):
        load_sweep(tmp_path / "sweep").load()
    assert sweep(ASKED, tmp_path / "sweep").load().identical(right)


def test_results_are_on_disk_before_they_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Shards are on disk before their seal, which is on disk before their parts are removed."""
    events: list[tuple[str, str]] = []
    honest = {"flush": os.fsync, "replace": os.replace, "unlink": Path.unlink}

    def flush(descriptor: int) -> None:
        events.append(("flush", os.readlink(f"/proc/self/fd/{descriptor}")))
        honest["flush"](descriptor)

    def replace(source: Any, target: Any) -> None:
        events.append(("name", str(target)))
        honest["replace"](source, target)

    def unlink(path: Path, missing_ok: bool = False) -> None:
        events.append(("gone", str(path)))
        honest["unlink"](path, missing_ok)

    monkeypatch.setattr(os, "fsync", flush)
    monkeypatch.setattr(os, "replace", replace)
    monkeypatch.setattr(Path, "unlink", unlink)
    sweep(ASKED, tmp_path / "sweep")
    (results,) = tmp_path.glob("sweep/*/results.zarr")
    (part,) = {path for kind, path in events if kind == "gone" and path.endswith("/0000002.npz")}
    seal = str(results.parent / "shards" / "0000001.json")
    sealed = events.index(("name", seal))
    shards = [str(path) for path in results.glob("*/c/1*") if path.is_file()]
    shards += [str(path) for path in results.glob("*/c/1/*/*") if path.is_file()]
    assert len(shards) > 3
    for path in shards:
        assert events.index(("flush", path)) < sealed
        assert ("flush", str(Path(path).parent)) in events[:sealed]
    assert ("flush", str(Path(seal).parent)) in events[sealed : events.index(("gone", part))]
    named = events.index(("name", part))
    assert events[named - 1][0] == "flush"
    assert events[named - 1][1].startswith(f"{Path(part).parent}/.0000002.")


def test_damaged_results_of_another_sweep_are_not_reused(folder: Path, right: Any):
    longer = ASKED | {"grid": {"chain.gravity": [*ASKED["grid"]["chain.gravity"], 5.0]}}
    zeros(next(folder.glob("*/results.zarr/velocity/c/1/0/0")))
    found = sweep(longer, folder).load()
    assert (found.reason != "not done").all()
    assert found.velocity[:5].equals(right.velocity)


# --- files of users


def test_a_sweep_json_of_a_user_is_preserved(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "sweep.toml").write_text(
        f"scene = {json.dumps(str(tmp_path / 'scene.toml'))}\n[grid]\n'chain.gravity' = [1.0]\n"
    )
    (tmp_path / "scene.toml").write_text(
        "[chain]\ngrains = 6\nmaterial = 'glass'\ndiameter = 1e-3\n"
        "[excitation]\nkind = 'impulse'\nvelocity = 1e-4\n[recording]\nduration = 1e-6\n"
    )
    (tmp_path / "sweep.json").write_text('{"mine": 1}')
    assert main(["sweep", f"{tmp_path}/sweep.toml", "-o", f"{tmp_path}", "--workers", "1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {tmp_path}/sweep.json: was not written by lmpchain: move it")
    assert (tmp_path / "sweep.json").read_text() == '{"mine": 1}'
    # An empty file, and those of earlier versions, are replaced.
    for text in ("", '{"format": 2, "results": "0123456789abcdef"}'):
        (tmp_path / "sweep.json").write_text(text)
        assert main(["sweep", f"{tmp_path}/sweep.toml", "-o", f"{tmp_path}", "--workers", "1"]) == 0


def test_a_lock_of_a_user_is_preserved(tmp_path: Path):
    (tmp_path / ".lock").write_text("mine")
    with pytest.raises(InputError, match=r"\.lock: is not a lock of lmpchain"):
        sweep(ASKED, tmp_path)
    assert (tmp_path / ".lock").read_text() == "mine"


def test_an_older_sweep_with_a_users_notes_is_preserved(folder: Path):
    """A longer sweep replaces an older one, but not if a user's notes are in its folder."""
    (old,) = (path.parent for path in folder.glob("*/store.json"))
    copy = shutil.copytree(folder, folder.with_name("copy"))
    longer = ASKED | {"grid": {"chain.gravity": [*ASKED["grid"]["chain.gravity"], 5.0]}}
    (old / "notes.md").write_text("mine")
    for place, kept in ((folder, True), (copy, False)):
        sweep(longer, place)
        assert (place / old.name).exists() is kept
    assert (old / "notes.md").read_text() == "mine"


# --- processes


UNGUARDED = """
import lmpchain
scene = {scene!r}
asked = {{"scene": scene, "grid": {{"chain.gravity": [1.0, 2.0, 3.0]}}}}
found = lmpchain.sweep(asked, "sweep", workers=2)
print("went on")
"""


@pytest.mark.slow
@pytest.mark.parametrize("from_file", [True, False])
def test_a_script_without_its_guard_fails_with_the_remedy(from_file: bool, tmp_path: Path):
    script = UNGUARDED.format(scene=SCENE)
    (tmp_path / "script.py").write_text(script)
    done = subprocess.run(
        [sys.executable, *(["script.py"] if from_file else ["-"])],
        input="" if from_file else script,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "went on" not in done.stdout
    assert done.stderr.splitlines()[-1].startswith("lmpchain.errors.InputError: workers: several")
    assert 'if __name__ == "__main__":' in done.stderr.splitlines()[-1]
    if from_file:
        assert done.stderr.count("Traceback") == 1
