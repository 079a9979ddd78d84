"""`import lmpchain` provides every name of the reference, and loads none of the modules."""

import subprocess
import sys

import pytest
from helpers.modules import listed_names

import lmpchain


def output_of(program: str) -> str:
    """Return the output of a new Python process."""
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.slow
def test_one_import_provides_every_name_of_the_reference():
    """The name must be in `dir`, because an attribute may also be a module loaded elsewhere."""
    names: dict[str, list[str]] = {}
    for package, _, name in (each.rpartition(".") for each in listed_names()):
        names.setdefault(package, []).append(name)
    assert sum(map(len, names.values())) > 50
    program = f"""
import sys
for package, names in {names}.items():
    for module in [module for module in sys.modules if module.startswith("lmpchain")]:
        del sys.modules[module]
    import lmpchain
    value = lmpchain
    for word in package.split(".")[1:]:
        value = getattr(value, word)
    for name in names:
        if name not in dir(value) or not hasattr(value, name):
            print(package, name)
"""
    assert output_of(program) == ""


def test_the_import_loads_no_other_module():
    program = "import sys, lmpchain; print(*[m for m in sys.modules if 'lmpchain' in m])"
    names = output_of(program).split()
    assert set(names) == {
        "lmpchain",
        "lmpchain.util",
        "lmpchain.util.lammps_import",
        "lmpchain.util.lazy",
    }
    assert "numpy" not in output_of("import sys, lmpchain; print(*sys.modules)").split()


@pytest.mark.parametrize("name", ["stability", "benchmark", "report", "trajectory", "doctor"])
def test_packages_are_listed(name: str):
    assert name in dir(lmpchain)
