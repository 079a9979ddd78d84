"""Only sealed files of lmpchain are replaced or removed in a run folder."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.child_processes import write
from helpers.example_scenes import paper, scene_of

from lmpchain import Chain, Impulse, InputError, Stopped, Trajectory, engines, resume, simulate
from lmpchain.cli.command_line import main
from lmpchain.simulation.folder_files import engine_of, strangers
from lmpchain.simulation.run_folder import status

SCENE = scene_of(Chain(grains=8, diameter=1e-3), Impulse(velocity=1e-4), 2e-5, 5)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    simulate(SCENE, "native", folder=folder)
    return folder


def contents(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def run_into(folder: Path, scene: Path, *options: str) -> int:
    return main(["run", str(scene), "-o", f"{folder}/", "--engine", "native", *options])


def refused(folder: Path, capsys: pytest.CaptureFixture[str], scene: Path, *options: str) -> str:
    """Run into a folder, which must be rejected and left unchanged; return the error line."""
    before = contents(folder)
    capsys.readouterr()
    assert run_into(folder, scene, *options) == 2
    assert contents(folder) == before
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {folder}")
    return line


# --- folders of the user


@pytest.mark.parametrize("order", ["{}", '{"rows": []}', "", "[1]", '{"sha256": "0"}', "[" * 99999])
@pytest.mark.parametrize("options", [(), ("--force",)])
def test_a_scene_beside_a_run_json_is_not_a_run_folder(
    order: str, options: tuple, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """A scene beside the output of `compare --json run.json` was once deleted as a run."""
    scene = write(SCENE, tmp_path)
    scene = scene.rename(tmp_path / "scene.toml")
    (tmp_path / "run.json").write_text(order)
    (tmp_path / "figure.png").write_bytes(b"picture")
    line = refused(tmp_path, capsys, scene, *options)
    assert "neither empty nor a run folder: figure.png, run.json, scene.toml were not" in line
    assert "--force" not in line
    with pytest.raises(InputError, match="figure"):
        simulate(SCENE, "native", folder=tmp_path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.json", "{}"),
        ("status.json", '{"state": "running"}'),
        ("status.json", ""),
        (".x.partial", "mine"),
        (".run.partial.json", "mine"),
        (".lock", "mine"),
        ("checkpoint", "mine"),
        ("SHA256SUMS", "mine"),
        ("log.lammps.txt", "mine"),
        ("notes.md", "mine"),
        ("data/notes.md", "mine"),
    ],
)
def test_a_file_of_a_user_is_not_overwritten(
    name: str, content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    scene = write(SCENE, tmp_path)
    folder = tmp_path / "run"
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_text(content)
    for options in ((), ("--force",)):
        assert name in refused(folder, capsys, scene, *options)


@pytest.mark.parametrize(
    "make", [lambda path: path.symlink_to(path.parent / "run.json"), os.mkfifo]
)
def test_a_link_or_pipe_is_not_opened(
    make: Callable[[Path], None], finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    scene = write(SCENE, tmp_path)
    (tmp_path / "new").mkdir()
    folder = shutil.copytree(finished, tmp_path / "run")
    for place in (tmp_path / "new", folder):
        (place / "status.json").unlink(missing_ok=True)
        make(place / "status.json")
    assert "status.json" in refused(tmp_path / "new", capsys, scene)
    for call in (status, resume):
        with pytest.raises(InputError, match=rf"^{folder}: .*status\.json"):
            call(folder)


# --- run folders with other files


@pytest.mark.parametrize(
    "name",
    [
        "notes.md",
        ".x.partial",
        ".notes.node-1-01234567.partial.md",
        "deck/in.column",
        "trajectory.zarr/notes.md",
        "trajectory.zarr/velocity/c/notes.md",
        "trajectory.zarr/velocity/c/0/notes.partial",
        "pictures/front.png",
    ],
)
def test_files_beside_a_run_are_preserved(
    name: str, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    scene = write(SCENE, tmp_path)
    folder = shutil.copytree(finished, tmp_path / "run")
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("mine")
    line = refused(folder, capsys, scene, "--force")
    assert name in line
    assert "move" in line
    # A run continues beside them.
    assert (resume(folder).velocity[:] == Trajectory.load(finished).velocity[:]).all()


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("scene.toml", lambda text: text + "# mine"),
        # In the encoding that is written here, this letter is not UTF-8.
        ("scene.toml", lambda text: text + "\xff"),
        ("run.json", lambda text: text.replace("1e-06", "1e-05")),
        ("run.json", lambda text: json.dumps(json.loads(text) | {"mine": 1})),
        ("status.json", lambda text: text.replace("finished", "Finished")),
        ("status.json", lambda _: "{}"),
        ("SHA256SUMS", lambda text: text + "mine"),
        (".lock", lambda _: "mine"),
    ],
)
def test_changed_files_are_preserved(
    name: str,
    change: Callable[[str], str],
    finished: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    scene = write(SCENE, tmp_path)
    folder = shutil.copytree(finished, tmp_path / "run")
    (folder / name).write_text(change((folder / name).read_text()), encoding="latin-1")
    assert name in refused(folder, capsys, scene, "--force")


@pytest.mark.parametrize("stop", [True, False])
def test_an_edited_deck_of_a_run_belongs_to_the_user(
    stop: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = tmp_path / "run"
    engine = engines.Lammps(integrator="verlet", step=1e-7, diameter="physical")
    scene = paper("fig5 g", 11)
    if stop:
        with pytest.raises(Stopped):
            simulate(scene, engine, folder=folder, max_wall=1e-9)
    else:
        simulate(scene, engine, folder=folder)
    assert strangers(folder) == []
    with open(folder / "deck" / "in.column", "a") as deck:
        deck.write("# mine\n")
    assert "deck/in.column" in refused(folder, capsys, write(SCENE, tmp_path), "--force")


def test_force_removes_the_run_and_keeps_the_folder(finished: Path, tmp_path: Path):
    scene = write(SCENE, tmp_path)
    folder = shutil.copytree(finished, tmp_path / "run")
    number = folder.stat().st_ino
    assert run_into(folder, scene, "--force", "--tolerance", "1e-3") == 0
    assert folder.stat().st_ino == number
    assert status(folder)["tolerance"] == 1e-3
    assert strangers(folder) == []
    listed = [line.split("  ")[1] for line in (folder / "SHA256SUMS").read_text().splitlines()]
    assert {"scene.toml", "run.json", "trajectory.zarr/velocity/zarr.json"} < set(listed)


def test_the_sums_list_the_files_of_lmpchain(tmp_path: Path):
    folder = tmp_path / "run"
    with pytest.raises(Stopped):
        simulate(SCENE, "native", folder=folder, max_wall=1e-9)
    (folder / "notes.md").write_text("mine")
    resume(folder)
    assert "notes.md" not in (folder / "SHA256SUMS").read_text()


def test_an_empty_folder_is_kept_if_a_run_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The folder existed before, and is not part of the run."""

    def refuse(*_: object) -> None:
        raise InputError.at("scene", "is refused late")

    monkeypatch.setattr(engines.Native, "start", refuse)
    (tmp_path / "old").mkdir()
    for name in ("old", "new"):
        with pytest.raises(InputError, match="refused late"):
            simulate(SCENE, "native", folder=tmp_path / name)
    assert os.listdir(tmp_path) == ["old"]
    assert os.listdir(tmp_path / "old") == []


def test_the_engine_of_a_folder_is_read(finished: Path, tmp_path: Path):
    assert engine_of(finished) == "native"
    assert engine_of(tmp_path) == ""
    for text in ("", "{}", '"engine"', "[1]", "[" * 99999):
        (tmp_path / "run.json").write_text(text)
        assert engine_of(tmp_path) == ""


# --- invalid names of folders


@pytest.mark.parametrize("name", [3, 1.5, None, True, b"run", ["run"], "", "a" * 300, "a\0b"])
def test_invalid_names_of_folders(name: object, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calls: list[Callable] = [resume, status]
    if name is not None:
        calls.append(lambda name: simulate(SCENE, "native", folder=name))
    for call in calls:
        with pytest.raises(InputError, match=r"^folder: "):
            call(name)
    assert os.listdir(tmp_path) == []
