"""The page about a run: title, summary cards, live view, panels and tables in one file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from os import PathLike
from pathlib import Path

import numpy as np

from ..chain.chain import Chain
from ..engines import class_of
from ..errors import InputError, LmpchainError
from ..measure.fit.overview import summary
from ..trajectory.trajectory import Trajectory
from ..util.files import check_readable, check_seal, expanded, write_aside
from ..util.plotting import si
from ..util.progress import ProgressBar
from ..util.tables import counted
from . import live, panels
from .live import render_live
from .panels import Panel
from .verdicts import front_below, linear_theory, strike_verdict, unit_of_key

NOT_RECORDED = {"date": "not recorded", "command": "not recorded"}


def origin(path: str | PathLike[str] | None) -> dict[str, str]:
    """Return the date and command of a saved run; the date of the file if none is stored."""
    answer = dict(NOT_RECORDED)
    if path is None:
        return answer
    path = expanded(path)
    with suppress(OSError, ValueError):
        written = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        answer["date"] = f"{_in_minutes(written)} (file)"
    # The file may have any content.
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        date, command = _of_folder(path) if path.is_dir() else _of_file(path)
        answer = {"date": _in_minutes(datetime.fromisoformat(date)), "command": command}
    return answer


def _of_folder(path: Path) -> tuple[str, str]:
    # The limit in bytes exceeds the length of any such file.
    check_readable(path / "run.json", 2**24)
    first = json.loads((path / "run.json").read_bytes())["sessions"][0]
    return str(first["began"]), str(first["command"])


def _of_file(path: Path) -> tuple[str, str]:
    """Return the date and command from the attribute `history` of a NetCDF file."""
    import h5py

    check_seal(path)
    with h5py.File(path, "r") as file:
        date, _, command = str(file.attrs["history"]).partition(" ")
    return date, command


def _in_minutes(date: datetime) -> str:
    return f"{date.astimezone(UTC).isoformat(' ', 'minutes')[:16]} UTC"


Rows = Sequence[Sequence[str]]
PANELS: dict[str, Callable[[Trajectory], Panel]] = {
    "Waveforms": panels.waveforms,
    "The front": panels.arrival,
    "Spectra": panels.spectra,
    "Dispersion": panels.dispersion,
    "Contacts": panels.forces,
    "Energy": panels.balance,
}


@dataclass(frozen=True)
class Section:
    """A part of the page: a picture, a table, a text, or the reason why it is missing."""

    title: str
    panel: Panel | None = None
    reason: str = ""
    rows: Rows = ()


def write(
    trajectory: Trajectory,
    path: str | PathLike[str],
    progress: bool = False,
    origin: Mapping[str, str] = NOT_RECORDED,
    overwrite: bool = False,
) -> None:
    """Write the page, atomically.

    Parameters
    ----------
    trajectory : Trajectory
    path : path
    progress, origin
        See `page`.
    overwrite : bool
        Whether to replace a file that lmpchain did not write; otherwise `InputError` is raised.
    """
    with write_aside(path, overwrite) as aside:
        aside.write_text(page(trajectory, progress, origin), encoding="utf-8")


def page(
    trajectory: Trajectory, progress: bool = False, origin: Mapping[str, str] = NOT_RECORDED
) -> str:
    """Return the page as self-contained HTML; parts that do not apply contain the reason.

    Parameters
    ----------
    trajectory : Trajectory
    progress : bool
        Whether to show a progress bar.
    origin : mapping
        Mapping with the "date" and the "command" of the run.

    Returns
    -------
    str
    """
    # The wave and the fits are steps of the progress bar, too.
    steps = len(PANELS) + 2
    with ProgressBar(steps, "report", " parts", shown=progress) as bar:
        bar.describe("The wave in space and time")
        # This picture is for readers without JavaScript, and for printing.
        still = panels.wave(trajectory)
        linear = linear_theory(live.crop(trajectory))
        numbers = live.figure_numbers([_view(trajectory, linear)])
        bar.advance()
        sections = list(_sections(trajectory, bar))
        bar.describe("Fits")
        fits = summary(trajectory)
        bar.advance()
    return render_live(
        "report.html",
        numbers,
        title=title(trajectory),
        cards=list(_cards(trajectory, linear, origin)),
        still=still,
        sections=sections,
        fits=list(fits.cells()) if fits.rows else [],
        notes=fits.notes,
        left_out=fits.left_out,
        facts=list(_facts(trajectory)),
        provenance=list(trajectory.provenance.items()),
        scene=trajectory.scene.to_text(),
        citation=_citation(trajectory),
    )


def _view(trajectory: Trajectory, linear: Trajectory | None) -> live.View:
    """Return the data of the live figure of a run."""
    try:
        front = front_below(trajectory)
    except InputError:
        # The panel of the front gives the reason.
        front = None
    between = live.extent(live.crop(trajectory))
    shown = live.view(trajectory, between, linear=linear, front=front)
    return shown.thinned(live.VIEW.times, live.VIEW.grains)


def title(trajectory: Trajectory) -> str:
    """Return the title of a run: chain, excitation, duration and engine."""
    scene = trajectory.scene
    chain = scene.chain
    weight = f"g = {chain.gravity:g} m/s²" if chain.gravity else "no gravity"
    load = f", load {chain.top_load:g} N{_of_load(chain)}" if chain.top_load else ""
    run = f"{scene.excitation.label}, {si(scene.duration, 's')}, {trajectory.engine}"
    return f"{counted(chain.grains, 'grain')}, {weight}{load}, {run}"


def _citation(trajectory: Trajectory) -> str:
    """Return a bibliography entry for the version of lmpchain that computed the run."""
    release = trajectory.provenance.get("lmpchain", version("lmpchain"))
    lines = [
        "@software{lmpchain,",
        "  title = {lmpchain: waves in columns of Hertzian grains},",
        "  author = {{The lmpchain developers}},",
        f"  version = {{{release}}}",
        "}",
    ]
    if cited := class_of(trajectory.engine).citation:
        lines.append(f"and {cited}")
    return "\n".join(lines)


def _of_load(chain: Chain) -> str:
    """Return a phrase about the loaded grain; empty for the first grain."""
    return f" on grain {chain.load_grain}" if chain.top_load and chain.load_grain > 1 else ""


def _sections(trajectory: Trajectory, bar: ProgressBar) -> Iterator[Section]:
    for name, draw in PANELS.items():
        bar.describe(name)
        # A fault removes one picture, never the whole page.
        try:
            yield Section(name, draw(trajectory))
        except LmpchainError as error:
            yield Section(name, reason=str(error))
        bar.advance()


def _cards(
    trajectory: Trajectory, linear: Trajectory | None, origin: Mapping[str, str]
) -> Iterator[tuple[str, str, str]]:
    """Yield the name, value and remark of each card."""
    scene = trajectory.scene
    error = trajectory.error_estimate
    cost = trajectory.cost
    strike = strike_verdict(live.crop(trajectory), linear)
    yield "Scene", f"{counted(scene.chain.grains, 'grain')}, {scene.excitation.label}", strike
    yield "Engine", trajectory.engine, f"solves Eq. ({trajectory.equation}) {cost.integrator}"
    tolerance = trajectory.provenance.get("tolerance", "not recorded")
    yield "Tolerance", tolerance, "largest relative error asked for"
    shares = f"{error.model:.2g} (equation) + {error.solver:.2g} (solver)"
    estimate = f"estimated: {shares}{error.remark}"
    yield "Error", f"{error.total:.2g}", estimate
    if scene.chain.damped:
        yield "Without damping", f"{scene.damping_effect:.2g}", scene.damping_remark
    computed = counted(cost.active_grains, "grain")
    work = f"{cost.steps_over(scene.duration)}, {computed} computed"
    yield "Cost", f"{cost.total_s:.3g} s", work
    yield "Date", origin["date"], ""
    yield "Command", origin["command"], ""


def _facts(trajectory: Trajectory) -> Iterator[tuple[str, str]]:
    scene = trajectory.scene
    cost = trajectory.cost
    chain = scene.chain
    ends = f"top {chain.top}, bottom {chain.bottom}"
    yield "chain", f"{counted(chain.grains, 'grain')}, {ends}, {chain.law}"
    yield "gravity and load", f"{chain.gravity:g} m/s², {chain.top_load:g} N{_of_load(chain)}"
    values = ", ".join(
        f"{key} {value:g} {unit_of_key(key, scene.excitation.kind)}".rstrip()
        if isinstance(value, int | float)
        else f"{key} of {np.size(value)} values"
        for key, value in scene.excitation.given().items()
        if value is not None
    )
    yield "excitation", f"{scene.excitation.kind}: {values}"
    samples = f"{trajectory.time.size} times up to {scene.duration:g} s"
    yield "recorded", f"{counted(trajectory.grains.size, 'grain')} at {samples}"
    yield "largest velocity", f"{np.abs(trajectory.velocity).max():.6g} m/s"
    yield "largest displacement", f"{np.abs(trajectory.displacement).max():.6g} m"
    # The fields of the cost name their unit.
    for key, value in cost._asdict().items():
        name = f"{key.removesuffix('_s')} (s)" if key.endswith("_s") else key
        yield name.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value)
