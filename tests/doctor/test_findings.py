"""Single checks of the doctor: their measurements and texts."""

import io
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lmpchain import Chain, LmpchainError, doctor
from lmpchain.doctor import Diagnosis, Finding, diagnose
from lmpchain.theory import modes
from lmpchain.util import mpi


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that runs one check and returns its findings as (name, state, text)."""
    every = list(doctor.CHECKS)

    def run(name: str) -> list[tuple[str, str, str]]:
        monkeypatch.setattr(doctor, "CHECKS", [each for each in every if each[0] == name])
        return [(each.name, each.state, each.found) for each in diagnose().findings]

    return run


@pytest.mark.parametrize(
    ("available", "total", "text", "scarce"),
    [
        (2_000_000, 4_000_000, "2.0 of 4.1 GB are free", False),
        (976_563, 8_000_000, "1.0 of 8.2 GB are free", False),
        (976_562, 8_000_000, "1.0 of 8.2 GB are free", True),
    ],
)
def test_memory_is_given_in_gigabytes_and_scarce_below_one(
    available: int, total: int, text: str, scarce: bool, check: Any, monkeypatch: Any
):
    meminfo = f"MemTotal:       {total} kB\nMemFree:  12 kB\nMemAvailable:   {available} kB\n"
    monkeypatch.setattr(Path, "read_text", lambda self: meminfo)
    warning = [("memory", "warning", "memory is scarce")] if scarce else []
    assert check("memory") == [("memory", "ok", text), *warning]


def test_only_available_cores_are_counted(check: Any, monkeypatch: Any):
    monkeypatch.setattr(
        os, "sched_getaffinity", lambda process: {0, 2, 5} if process == 0 else set()
    )
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    assert check("cores") == [("cores", "ok", "3 of 8 may be used")]


def test_a_temporary_folder_has_room_for_a_megabyte(check: Any, monkeypatch: Any):
    written: list[int] = []

    class File(io.BytesIO):
        def write(self, content: Any) -> int:
            written.append(len(content))
            return super().write(content)

    monkeypatch.setattr(tempfile, "TemporaryFile", File)
    assert check("temporary folder") == [("temporary folder", "ok", tempfile.gettempdir())]
    assert written == [2**20]


@pytest.mark.parametrize(
    ("off", "sound"), [(0.0, True), (0.5e-12, True), (1.1e-12, False), (-1.1e-12, False)]
)
def test_eigenmodes_are_accurate_to_twelve_digits(
    off: float, sound: bool, check: Any, monkeypatch: Any
):
    def eigenmodes(chain: Chain) -> Any:
        return SimpleNamespace(frequency=[0.0, chain.band_edge * (1 + off)])

    monkeypatch.setattr(modes, "eigenmodes", eigenmodes)
    ((name, state, text),) = check("eigenmodes")
    assert (name, state) == ("eigenmodes", "ok" if sound else "fault")
    assert text.startswith("highest frequency: relative error ")
    told = float(text.split()[4])
    assert told == pytest.approx(abs(off), abs=3e-13)
    assert text.endswith(" (must be 1e-12 or less)")


@pytest.mark.parametrize(
    ("wrong", "sound"), [(0.9e-6, True), (1.1e-6, False), (float("nan"), False)]
)
def test_engines_are_accurate_to_a_millionth(
    wrong: float, sound: bool, check: Any, monkeypatch: Any
):
    times = iter([100.0, 102.5])
    asked: list[Any] = []
    monkeypatch.setattr(doctor, "time", SimpleNamespace(perf_counter=lambda: next(times)))
    monkeypatch.setattr(
        "lmpchain.simulation.api.simulate", lambda *values: asked.extend(values) or "answer"
    )
    monkeypatch.setattr("lmpchain.benchmark.reference.reference", lambda scene: ("truth of", scene))
    monkeypatch.setattr("lmpchain.benchmark.comparison.error", lambda answer, truth: wrong)
    ((name, state, text),) = check("native engine")
    scene, engine, tolerance = asked
    assert (engine, tolerance) == ("native", 1e-6)
    assert scene.chain.grains * scene.samples < 300, "it takes a second at most"
    assert scene.strike_number > 0
    assert (name, state) == ("native engine", "ok" if sound else "fault")
    assert text == f"error {wrong:.1e} (must be 1e-06 or less) in 2.5 s"


def test_two_ranks_are_started_and_report_their_number(check: Any, monkeypatch: Any):
    asked: dict[str, Any] = {}

    def start(command: list[str], **options: Any) -> Any:
        asked.update(options, command=command)
        return SimpleNamespace(returncode=0, stdout="[2, 2]\n", stderr="")

    monkeypatch.setattr(mpi, "launcher", lambda: "/bin/mpiexec")
    monkeypatch.setattr(subprocess, "run", start)
    assert check("mpiexec") == [("mpiexec", "ok", "/bin/mpiexec, whose two ranks communicate")]
    assert asked["command"][:4] == ["/bin/mpiexec", "-n", "2", sys.executable]
    assert (asked["capture_output"], asked["text"], asked["stdin"]) == (
        True,
        True,
        subprocess.DEVNULL,
    )
    assert 5 < asked["timeout"] < 60

    def silent(command: list[str], **options: Any) -> Any:
        return SimpleNamespace(
            returncode=3, stdout="", stderr="---\nfirst\nan Error in one\nan Error in two\nlast\n"
        )

    monkeypatch.setattr(subprocess, "run", silent)
    assert check("mpiexec") == [("mpiexec", "fault", "/bin/mpiexec failed: an Error in two")]


@pytest.mark.parametrize(
    ("installed", "least", "sound"),
    [
        ("1.2.3", "1.2", True),
        ("1.2", "1.2", True),
        ("1.10", "1.9", True),
        ("1.1.9", "1.2", False),
        ("2", "1.9", True),
    ],
)
def test_versions_are_compared_number_by_number(
    installed: str, least: str, sound: bool, check: Any, monkeypatch: Any
):
    monkeypatch.setattr(
        doctor, "requires", lambda name: [f"tool>={least}", "any", 'extra>=1; extra == "x"']
    )
    monkeypatch.setattr(doctor, "version", lambda name: installed)
    monkeypatch.setattr(doctor, "metadata", lambda name: {"Requires-Python": ">=3.11"})
    states = {name: (state, text) for name, state, text in check("lmpchain")}
    assert states["tool"] == ("ok" if sound else "fault", f"{installed} (must be {least} or later)")
    assert states["any"] == ("ok", f"{installed} (must be 0 or later)")
    assert "extra" not in states
    assert states["python"][0] == "ok"


def test_a_library_is_described_in_one_line(check: Any, monkeypatch: Any):
    library = SimpleNamespace(Get_library_version=lambda: "MPICH   Version:\t4.2,  of today\nmore")
    monkeypatch.setattr(mpi, "library", lambda: library)
    name, described = check("mpi4py")
    assert name[0] == "mpi4py"
    assert described == ("MPI library", "ok", "MPICH Version: 4.2")


def raising(error: Exception) -> Iterator[Finding]:
    raise error
    yield


@pytest.mark.parametrize(
    ("error", "text", "cure"),
    [
        (LmpchainError("it is not here: pip install it"), "it is not here", "do this"),
        (
            ImportError("none", name="scipy.linalg"),
            "ImportError: none",
            "pip install --force-reinstall scipy",
        ),
        (ImportError("none"), "ImportError: none", "do this"),
    ],
)
def test_a_fault_has_a_text_and_a_remedy(
    error: Exception, text: str, cure: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(doctor, "CHECKS", [("a", "do this", lambda: raising(error))])
    (finding,) = diagnose().findings
    assert finding == Finding("a", "fault", text, cure)


def test_a_summary_counts():
    fault, warning, ok = (Finding("a", state, "b") for state in ("fault", "warning", "ok"))
    for findings, text in (
        ((ok,), "all is well"),
        ((fault,), "1 fault"),
        ((warning, warning), "2 warnings"),
        ((fault, warning, fault, ok), "2 faults and 1 warning"),
    ):
        assert Diagnosis(findings).summary == text
    told = {"name": "a", "state": "ok", "found": "b", "cure": ""}
    assert Diagnosis((ok,)).to_json() == {"summary": "all is well", "findings": [told]}


def test_a_numba_without_compilation_is_named(check: Any, monkeypatch: Any):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    [(_, state, text)] = check("numba cache")
    assert state == "warning"
    assert "NUMBA_DISABLE_JIT" in text


@pytest.mark.parametrize(("pace_s", "said"), [(0.7, True), (0.01, False)])
def test_long_compilation_is_announced(pace_s: float, said: bool, monkeypatch: Any):
    """The time of one job predicts the time of the others, which is nearly 0 if they are cached."""
    total_s = [0.0]

    def take(*_: Any, **__: Any) -> None:
        total_s[0] += pace_s

    monkeypatch.setattr("lmpchain.util.compilation.compiled_s", lambda: total_s[0])
    for name in ("simulation.api.simulate", "measure.front.track", "design.gradient"):
        monkeypatch.setattr(f"lmpchain.{name}", take)
    monkeypatch.setattr("lmpchain.integrators.kernels.contact_forces.addresses", take)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        doctor.compile_all()
    texts = [str(each.message) for each in told]
    assert len(texts) == said
    # 139 s for the jobs after the first one, which takes 0.7 s.
    assert not said or "takes about 2.3 minutes: without --compile" in texts[0]
