"""How much memory is free, and a limit on what a piece of work takes."""

import resource

import pytest

from lmpchain.cli.command_line import main
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


def test_a_command_says_in_one_line_that_memory_ran_out(monkeypatch, capsys):
    def run_out(_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("lmpchain.scene.scene.Scene.from_toml", run_out)
    assert main(["run", "scene.toml"]) == 1
    assert capsys.readouterr().err.startswith("error: memory ran out: ")
