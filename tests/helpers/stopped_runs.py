"""Runs that are stopped by their time limit and resumed."""

import itertools
from pathlib import Path
from typing import Any

import pytest

from lmpchain import Scene, Stopped, resume, simulate
from lmpchain.engines.stepping import time_stepping as stepping_run


def stop_three_times(
    scene: Scene, engine: Any, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> Any:
    """Return the trajectory of a run that stops after its first three blocks and is resumed."""
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)
    stops = 0
    for attempt in itertools.count():
        limit = 1e-9 if attempt < 3 else None
        try:
            if attempt == 0:
                answer = simulate(scene, engine, folder=folder, max_wall=limit)
            else:
                answer = resume(folder, max_wall=limit)
            break
        except Stopped:
            stops += 1
    assert stops == 3
    return answer
