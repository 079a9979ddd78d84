"""Compiled code that is damaged, or cannot be cached, is compiled again with a message."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MODULE = """
from lmpchain.util.compilation import compiled_once

@compiled_once("a test", 1)
def twice(x):
    return 2 * x
"""
SCRIPT = """
import kept
print(kept.twice(21), sum(kept.twice.stats.cache_hits.values()))
"""


def call_in_new_process(folder: Path, *limit: str, **variables: str) -> tuple[str, str]:
    """Call the function in a separate process; return its output and its warnings."""
    words = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(
        ["bash", "-c", f'{" ".join(limit) or ":"}; exec "$@"', "bash", *words],
        cwd=folder,
        env=os.environ | {"NUMBA_CACHE_DIR": f"{folder}/cache"} | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    complaints = [line for line in done.stderr.splitlines() if "UserWarning" in line]
    return done.stdout.strip(), "\n".join(complaints)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "kept.py").write_text(MODULE)
    (tmp_path / "cache").mkdir()
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_damaged_files_are_recompiled(suffix: str, folder: Path):
    """Other kinds of damage are tried within one process, see test_progress.py."""
    assert call_in_new_process(folder) == ("42 0", "")
    assert call_in_new_process(folder) == ("42 1", "")
    (path,) = (folder / "cache").rglob(f"*.{suffix}")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    said, complaints = call_in_new_process(folder)
    assert said == "42 0"
    assert str(path) in complaints
    assert "set NUMBA_CACHE_DIR" in complaints
    assert call_in_new_process(folder) == ("42 1", "")


@pytest.mark.slow
def test_a_full_disk_caches_nothing_and_warns(folder: Path):
    said, complaints = call_in_new_process(folder, "ulimit -f 0")
    assert said == "42 0"
    assert f"{folder}/cache" in complaints
    assert "File too large" in complaints
    assert call_in_new_process(folder) == ("42 0", "")


def test_kernels_run_only_compiled(folder: Path):
    said, complaints = call_in_new_process(folder, NUMBA_DISABLE_JIT="1")
    assert said == "42 0"
    assert "NUMBA_DISABLE_JIT is ignored" in complaints


GROWN = """
import numpy as np

@compiled_once("a test", 1)
def doubled(values):
    return (2 * values).sum()

@compiled_once("a test", 1)
def summed(values):
    return doubled(values) + np.ones(3).sum()
"""
CALLS = """
import sys
import numpy as np
import kept
print(kept.doubled(np.arange(3.0)), sum(kept.doubled.stats.cache_hits.values()))
print(COMPILER in sys.modules)
"""
LATER = "print(kept.summed(np.arange(3.0)))"


@pytest.mark.slow
def test_cached_code_needs_no_compiler_and_is_called_by_later_compiled_code(folder: Path):
    (folder / "kept.py").write_text(MODULE + GROWN)

    def printed(script: str) -> list[str]:
        compiler = "COMPILER = 'numba.typed.typeddict'\n"
        command = [sys.executable, "-c", compiler + script]
        environment = os.environ | {"NUMBA_CACHE_DIR": f"{folder}/cache"}
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    assert printed(CALLS) == ["6.0", "0", "True"]
    assert printed(CALLS) == ["6.0", "1", "False"]
    assert printed(CALLS + LATER) == ["6.0", "1", "False", "9.0"]
