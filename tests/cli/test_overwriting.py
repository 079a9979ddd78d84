"""Files that lmpchain did not write are preserved by all commands and functions."""

from pathlib import Path

import pytest
from helpers.command_output import SCENE
from helpers.thinned import thinned

from lmpchain import InputError, Scene, Trajectory, explore, report, simulate
from lmpchain.cli.command_line import main
from lmpchain.cli.verbs import VERBS
from lmpchain.engines.lammps import export
from lmpchain.measure import traces

# Options of each command that writes files, and these files.
WRITERS = {
    "new": ("FILE.toml", ()),
    "run": ("-o FILE.nc", ()),
    "compare": ("--engines native -o FILE.png", ("--engines native --json FILE.json",)),
    "plan": ("--json FILE.json", ()),
    "averages": ("--of temperature -o FILE.png", ("--of temperature --json FILE.json",)),
    "orbit": ("--mode 1 --energy 1e-12 -o FILE.png", ("--mode 1 --energy 1e-12 --json FILE.json",)),
    "sensitivity": ("--answer momentum:5 -o FILE.png", ("--of momentum:5 --json FILE.json",)),
    "deck": ("-o FOLDER", ()),
    "dyson": ("--m 1 -o FILE.png", ("--m 1 --json FILE.json",)),
    "export": ("-o FILE.csv", ()),
    "check": ("--json FILE.json", ()),
    "fit": ("--json FILE.json", ()),
    "report": ("-o FILE.html", ()),
    "explore": ("--over excitation.velocity=1e-4:2e-4:2 -o FILE.html", ()),
    "workprec": ("-o FILE.png", ("--json FILE.json",)),
    "stability": ("-o FILE.png", ("--json FILE.json",)),
    "doctor": ("--json FILE.json", ()),
}
READ_RUNS = ("dyson", "export", "check", "fit", "report")
WRITE_FOLDERS_OR_NOTHING = {"resume", "sweep", "docs"}
CASES = [(verb, words) for verb, (first, rest) in WRITERS.items() for words in (first, *rest)]
QUICK = ("new", "run", "compare", "plan", "deck", "export", "fit", "report", "explore")


@pytest.fixture(scope="module")
def answer() -> Trajectory:
    return simulate(Scene.from_text(SCENE), "native")


@pytest.fixture(
    params=thinned([(case,) for case in CASES], 2), ids=[" ".join(case) for case in CASES]
)
def command(request, tmp_path: Path, answer: Trajectory) -> tuple[list[str], Path]:
    """A command with a user's file at its output path."""
    verb, words = request.param
    (tmp_path / "scene.toml").write_text(SCENE)
    answer.save(tmp_path / "run.nc")
    source = str(tmp_path / ("run.nc" if verb in READ_RUNS else "scene.toml"))
    given = [] if verb in ("new", "doctor") else [source]
    (tmp_path / "FOLDER").mkdir()
    arguments = [
        str(tmp_path / word) if word.startswith(("FILE", "FOLDER")) else word
        for word in words.split()
    ]
    file = Path(next(word for word in arguments if word.startswith(str(tmp_path))))
    file = file / "in.column" if file.is_dir() else file
    file.write_text("my own")
    return [verb, *given, *arguments], file


def test_all_commands_that_write_files_are_tested():
    assert set(WRITERS) | WRITE_FOLDERS_OR_NOTHING == set(VERBS)


def test_a_command_preserves_a_file_of_a_user(command, capsys: pytest.CaptureFixture[str]):
    arguments, file = command
    assert main(arguments) == 2
    assert "--force" in capsys.readouterr().err
    assert file.read_text() == "my own"
    if arguments[0] in QUICK:
        assert main([*arguments, "--force"]) == 0
        assert file.read_bytes() != b"my own"


def test_a_command_replaces_its_own_output_until_it_is_edited(tmp_path: Path, answer: Trajectory):
    answer.save(tmp_path / "run.nc")
    page = tmp_path / "run.html"
    export = ["export", str(tmp_path / "run.nc"), "-o", str(tmp_path / "run.csv")]
    assert main(export) == main(export) == 0
    table = tmp_path / "run.csv"
    table.write_text(table.read_text() + "\n")
    assert main(export) == 2
    page.symlink_to(table)  # A link belongs to the user, whatever its target is.
    assert main(["report", str(tmp_path / "run.nc")]) == 2


WRITES = {
    "save": lambda run, path, **options: run.save(path, **options),
    "to_extxyz": lambda run, path, **options: run.to_extxyz(path, **options),
    "to_csv": lambda run, path, **options: run.to_csv(path, **options),
    "traces": lambda run, path, **options: traces.gather(run, velocity=[1]).to_csv(path, **options),
    "to_toml": lambda run, path, **options: run.scene.to_toml(path, **options),
    "report": lambda run, path, **options: report.write(run, path, **options),
    "explore": lambda run, path, **options: explore(
        {"scene": run.scene, "over": {"excitation.velocity": [1e-4, 2e-4]}}, path, **options
    ),
}


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(write, id=name, marks=pytest.mark.slow if name == "report" else ())
        for name, write in WRITES.items()
    ],
)
def test_a_call_preserves_a_file_of_a_user(write, answer: Trajectory, tmp_path: Path):
    path = tmp_path / "file"
    path.write_text("my own")
    with pytest.raises(InputError, match=r"lmpchain did not write: .*overwrite=True"):
        write(answer, path)
    assert path.read_text() == "my own"
    write(answer, path, overwrite=True)
    content = path.read_bytes()
    assert content != b"my own"
    write(answer, path)  # A script that runs again writes the same file.


@pytest.mark.parametrize("name", ["column.data", "column.lammpstrj", "log.lammps", "in.column"])
def test_files_of_lammps_are_preserved(name, answer: Trajectory, tmp_path: Path):
    (tmp_path / name).write_text("my own")
    with pytest.raises(InputError, match=r"did not write|not written by lmpchain"):
        export.write_deck(answer.scene, tmp_path)
    with pytest.raises(InputError, match=r"did not write|not written by lmpchain"):
        simulate(answer.scene, "lammps", 1e-2, integrator="verlet", keep=tmp_path)
    assert (tmp_path / name).read_text() == "my own"
    export.write_deck(answer.scene, tmp_path, overwrite=True)
    export.write_deck(answer.scene, tmp_path)
