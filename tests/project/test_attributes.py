"""What the reference lists is there after `import lmpchain`, which loads none of it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import lmpchain

REFERENCE = Path(__file__).parents[2] / "docs" / "api.md"


def listed_names() -> list[str]:
    """Return what the reference lists, with dotted names."""
    names = []
    package = ""
    for line in REFERENCE.read_text(encoding="utf-8").splitlines():
        if line.startswith(".. currentmodule:: "):
            package = line.split()[-1]
        elif re.fullmatch(r"   [\w.]+", line):
            names.append(f"{package}.{line.strip()}")
    return names


def run(program: str) -> str:
    """Return what a fresh Python prints."""
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout


def test_the_reference_is_there_after_one_import():
    names = listed_names()
    assert len(names) > 50
    program = f"""
import sys
import lmpchain
for name in {names}:
    for module in [module for module in sys.modules if module.startswith("lmpchain")]:
        del sys.modules[module]
    import lmpchain
    value = lmpchain
    try:
        for word in name.split(".")[1:]:
            value = getattr(value, word)
    except AttributeError as error:
        print(name, error)
"""
    assert run(program) == ""


def test_the_import_loads_none_of_it():
    program = "import sys, lmpchain; print(*[m for m in sys.modules if 'lmpchain' in m])"
    names = run(program).split()
    assert set(names) == {
        "lmpchain",
        "lmpchain.util",
        "lmpchain.util.lammps_import",
        "lmpchain.util.lazy",
    }
    assert "numpy" not in run("import sys, lmpchain; print(*sys.modules)").split()


@pytest.mark.parametrize("name", ["stability", "benchmark", "report", "trajectory", "doctor"])
def test_packages_are_listed(name: str):
    assert name in dir(lmpchain)
