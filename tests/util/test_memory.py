"""Free memory, and a memory limit for a task."""

import resource
import subprocess
import sys
import tomllib

import pytest
import tomli_w
from helpers.command_output import SCENE

from lmpchain.util.memory import free_memory, memory_limit


def test_a_limit_ends_with_its_block():
    before = resource.getrlimit(resource.RLIMIT_AS)
    with memory_limit(2**26):
        assert free_memory() <= 2**26
        bytearray(2**20)
        with pytest.raises(MemoryError):
            bytearray(2**27)
    assert resource.getrlimit(resource.RLIMIT_AS) == before
    assert free_memory() > 2**26


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [400_000, 800_000])
def test_a_sweep_with_little_memory_ends(kilobytes, tmp_path):
    """The sweep gives results or an error of one line."""
    scenes = {"scene": tomllib.loads(SCENE), "grid": {"chain.gravity": [1.0, 2.0]}}
    source = tmp_path / "sweep.toml"
    source.write_text(tomli_w.dumps(scenes | {"keep": ["wall_force"]}))
    line = [sys.executable, "-m", "lmpchain.cli", "sweep", source, "-o", tmp_path / "out"]
    limited = ["sh", "-c", f'ulimit -v {kilobytes}; exec "$@"', "sh", *line, "--workers", "2"]
    done = subprocess.run(limited, capture_output=True, text=True)
    assert done.returncode in (0, 1)
    assert "Traceback" not in done.stderr
    assert done.stdout or done.stderr.startswith("error: ")
