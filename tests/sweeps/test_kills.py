"""A sweep resumes after any of its processes is killed, and ends with identical results."""

import itertools
import os
import random
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest
from helpers.child_processes import Fork, processes, until
from helpers.example_sweeps import contents, done, long_sweep

import lmpchain
from lmpchain import load_sweep
from lmpchain.cli.command_line import main

SCENES = 200
PACKAGE = Path(lmpchain.__file__).parent


def values(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all results of a sweep, by name."""
    found = load_sweep(folder).load()
    return {
        str(name): array.values.astype(str if array.dtype == object else array.dtype).tobytes()
        for name, array in found.variables.items()
    }


def killed(folder: Path, parts: list[float], rng: random.Random) -> tuple[int, int]:
    """Run a sweep, and kill a random one of its processes after a number of scenes is done.

    Returns how often something was killed, and how often it was the process that leads. A part
    below 0 is of the time before the first scene.
    """
    scratch = folder / "scratch"
    mark = f"MARK={folder}"
    out = folder / "out"
    counts = [0, 0]
    scratch.mkdir(parents=True)
    path = long_sweep(folder, SCENES)
    environment = os.environ | {"MARK": str(folder), "TMPDIR": str(scratch)}
    words = ["sweep", path, "-o", out, "--workers"]
    for part in parts:
        process = Fork(
            main, [*words, rng.choice([1, 2])], environment, folder.with_name(f"{folder.name} said")
        )
        while process.poll() is None and done(out) < part * SCENES:
            time.sleep(0.02)
        # A random delay separates the kill from the end of a scene.
        time.sleep(rng.uniform(0, 3) if part < 0 else rng.uniform(0, 0.1))
        there = processes(mark)  # Worker processes.
        victim = process.pid if rng.random() < 0.7 or not there else rng.choice(there)
        alive_still = process.poll() is None
        with suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
        code, said = process.ended()
        # Python's own resource tracker reports how it was killed.
        assert f'File "{PACKAGE}' not in said, said
        assert code in (0, -signal.SIGKILL), said
        until(lambda: not processes(mark))  # No process remains.
        counts[0] += alive_still
        counts[1] += code == -signal.SIGKILL
    last = Fork(
        main, [*words, rng.choice([1, 2])], environment, folder.with_name(f"{folder.name} said")
    )
    code, said = last.ended()
    assert code == 0, said
    until(lambda: not processes(mark))
    assert os.listdir(scratch) == []
    assert sorted(os.listdir(folder)) == ["out", "scratch", "sweep.toml"]
    return counts[0], counts[1]


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the same sweep on one process without interruptions."""
    folder = tmp_path_factory.mktemp("serial")
    words = ["sweep", str(long_sweep(folder, SCENES)), "-o", str(folder / "out")]
    assert main([*words, "--workers", "1"]) == 0
    return folder / "out"


@pytest.mark.soak
@pytest.mark.timeout(0)
@pytest.mark.parametrize("piece", range(5))
def test_random_kills(piece: int, tmp_path: Path, serial: Path):
    """Ten kills at random, some of them in the same sweep."""
    rng = random.Random(f"sweep {piece}")
    count = 0
    for again in itertools.count():
        parts = sorted(rng.uniform(-0.2, 1) for _ in range(rng.choice([1, 2, 3, 4])))
        kills, leaders = killed(tmp_path / str(again), parts, rng)
        assert values(tmp_path / str(again) / "out") == values(serial), parts
        assert contents(tmp_path / str(again) / "out") == contents(serial), parts
        count += kills
        print(
            f"sweep {piece}: {count} kills, {leaders} of the leader, "
            f"{[round(part, 2) for part in parts]}",
            flush=True,
        )
        if count >= 10:
            break
