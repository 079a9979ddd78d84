"""A scene file, and the output and files of a command."""

import re
from pathlib import Path
from typing import Any

import pytest

from lmpchain.cli import main
from lmpchain.cli.verbs import VERBS

SCENE = """
[chain]
grains = 20
material = "glass"
diameter = 1.0e-3

[excitation]
kind = "impulse"
velocity = 8.57e-4

[recording]
duration = 20e-6
samples = 11
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def keys(said: Any) -> list[str]:
    """Return the keys of the faults on stderr, after checking that there is no other text."""
    found = [re.fullmatch(r"error: (\S+): \S.*", line) for line in said.err.splitlines()]
    assert found
    assert all(found), said.err
    return [match[1] for match in found if match]


def parsed(verb: str, *words: str) -> Any:
    """Return the arguments that the function of a command receives, without calling it."""
    received: list[Any] = []
    recorder = VERBS[verb]._replace(command=lambda given: received.append(given) or 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(VERBS, verb, recorder)
        assert main([verb, *words]) == 0
    del received[0].command
    return received[0]
