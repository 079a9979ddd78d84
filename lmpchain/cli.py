"""The command line: `lmpchain run`, `compare` and `deck`.

Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 130 after Ctrl-C,
143 after SIGTERM.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import EngineUnavailable, InputError, LmpchainError, RunFailed, ToleranceNotMet

# what computes is imported inside the functions, so that --help answers at once
if TYPE_CHECKING:
    from .reference import Reference
    from .scene import Scene
    from .trajectory import Trajectory

PICTURES = (".png", ".pdf", ".svg")
REFERENCE_S = 60.0  # longest expected time for the independent reference; the native engine takes over beyond it
TIGHTEST = 1e-11  # tolerance that the native engine reaches on every ordinary scene


class _Terminated(BaseException):
    """SIGTERM arrived. Not an Exception, so that nothing on the way out takes it for a fault."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the name of the program; those of the process by default.
    """
    try:
        arguments = _parser().parse_args(argv)
    except SystemExit as asked:  # --help, --version, or arguments that argparse refused and explained
        return int(asked.code or 0)
    before = _on_sigterm(_terminated)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning  # type: ignore[assignment]
            return arguments.command(arguments)
    except InputError as error:
        for key, message in error.faults:
            _complain(f"{key}: {message}")
        return 2
    except LmpchainError as error:
        _complain(str(error))
        return 1
    except KeyboardInterrupt:
        print("stopped by Ctrl-C; nothing unfinished was kept", file=sys.stderr)
        return 130
    except _Terminated:
        print("stopped by SIGTERM; nothing unfinished was kept", file=sys.stderr)
        return 143
    finally:
        _on_sigterm(before)


def _terminated(*_: Any) -> None:
    raise _Terminated


def _on_sigterm(handler: Any) -> Any:
    """Install a handler and return the one before; other threads than the main one may not."""
    if threading.current_thread() is not threading.main_thread():
        return None
    before = signal.getsignal(signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.SIG_DFL if handler is None else handler)
    return before


def _complain(text: str) -> None:
    print(f"error: {' '.join(text.split())}", file=sys.stderr)


def _show_warning(message: Warning | str, *_: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


class _ShowVersion(argparse.Action):
    """Look the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"lmpchain {version('lmpchain')}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="lmpchain",
        description="Waves in columns of Hertzian grains: LAMMPS and a native integrator, side by side, each with an "
        "estimate of its own error. All quantities are in SI units.",
        epilog="Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong.",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    run = commands.add_parser("run", help="answer a scene and save the trajectory as NetCDF")
    _scene(run, _run)
    run.add_argument("-o", "--output", metavar="RUN.nc", help="file to write (default: SCENE.nc beside the scene)")
    run.add_argument("--engine", metavar="E", default="auto", help="which engine answers (default: auto)")
    _tolerance(run)
    run.add_argument("--integrator", metavar="I", help="rkn6, kahan-li6 or verlet (default: what the engine prefers)")
    run.add_argument("--step", metavar="S", type=float, help="longest time step, s; then no tolerance is enforced")
    run.add_argument(
        "--diameter",
        choices=["auto", "physical", "gauge"],
        help="LAMMPS only: positions from the real diameters, or from a far smaller one that leaves more digits",
    )

    compare = commands.add_parser("compare", help="answer a scene with several engines and compare with the truth")
    _scene(compare, _compare)
    compare.add_argument("--engines", metavar="A,B,...", help="which engines (default: all that can do the scene)")
    _tolerance(compare)
    compare.add_argument("-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)")
    compare.add_argument("--json", metavar="FILE", help="file for the numbers")

    deck = commands.add_parser("deck", help="write a LAMMPS input that runs by itself")
    _scene(deck, _deck)
    deck.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder for in.column and column.data")
    _tolerance(deck)
    deck.add_argument("--step", metavar="S", type=float, help="longest time step, s (default: from the tolerance)")
    deck.add_argument("--diameter", choices=["physical", "gauge", "auto"], default="physical")
    deck.add_argument("--integrator", choices=["verlet", "kahan-li6"], default="verlet")
    deck.add_argument("--pair-style", choices=["granular", "gran/hertz/history"], default="granular")
    return parser


def _scene(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="scene file")
    parser.set_defaults(command=command)


def _tolerance(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--tolerance", metavar="X", type=float, default=1e-6, help="largest relative solver error (default: 1e-6)"
    )


def _gather(*checks: Callable[[], Any]) -> list[Any]:
    """Return what the checks return; raise one `InputError` with the faults of all of them."""
    results, faults = [], []
    for check in checks:
        try:
            results.append(check())
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return results


def _read(path: str) -> Scene:
    from .scene import Scene

    return Scene.from_toml(path)


def _check_tolerance(value: float) -> None:
    if not 0 < value < 1:
        raise InputError([("tolerance", f"must be between 0 and 1 (got {value!r})")])


def _output(name: str, scene: str, suffixes: Sequence[str] = ()) -> Path:
    """Return the path of a file to write, once it is clear that it can be written."""
    path = Path(name)
    if path.is_dir() or name.endswith(("/", os.sep)):
        raise InputError([(name, f"is a folder; name a file, such as {path / 'run.nc' if not suffixes else path}")])
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError([(name, f"must end in {', '.join(suffixes[:-1])} or {suffixes[-1]}")])
    if path.exists() and Path(scene).exists() and path.samefile(scene):
        raise InputError([(name, "is the scene file itself; name another file")])
    if not path.parent.is_dir():
        raise InputError([(name, f"there is no folder {path.parent}; make it first")])
    if not os.access(path.parent, os.W_OK | os.X_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise InputError([(name, "you may not write there; choose another place")])
    return path


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options given for the engine, once it is clear that the engine has them."""
    from inspect import signature

    from . import engines

    given = {key: getattr(arguments, key) for key in ("integrator", "step", "diameter")}
    given = {key: value for key, value in given.items() if value is not None}
    engine = engines.get(arguments.engine)
    known = [key for key in signature(type(engine)).parameters if key in ("integrator", "step", "diameter", "ranks")]
    if faults := [
        (key, f"the engine {engine.name} has no such option; leave --{key} out (it knows {', '.join(known)})")
        for key in given
        if key not in known
    ]:
        raise InputError(faults)
    return given


def _run(arguments: argparse.Namespace) -> int:
    scene, path, options, _ = _gather(
        lambda: _read(arguments.scene),
        lambda: arguments.output and _output(arguments.output, arguments.scene),
        lambda: _options(arguments),
        lambda: _check_tolerance(arguments.tolerance),
    )
    path = path or _output(str(Path(arguments.scene).with_suffix(".nc")), arguments.scene)
    from .simulation import simulate

    missed = ""
    try:
        trajectory = simulate(scene, arguments.engine, arguments.tolerance, progress=sys.stderr.isatty(), **options)
    except ToleranceNotMet as error:
        if error.trajectory is None:
            raise
        trajectory, missed = error.trajectory, error.reason
    trajectory.save(path)
    print(_summary(trajectory, arguments.tolerance, path))
    if missed:
        _complain(missed)
    return 1 if missed else 0


def _summary(trajectory: Trajectory, tolerance: float, path: Path) -> str:
    """Return in a few lines what was done, how well and at what cost."""
    cost, error, scene = trajectory.cost, trajectory.error_estimate, trajectory.scene
    parts = f" = {error.model:.2g} (equation) + {error.solver:.2g} (solver)" if error.model else ""
    lines = {
        "engine": f"{trajectory.engine}, which solves Eq. ({trajectory.equation})",
        "scene": f"{scene.chain.grains} grains, {scene.samples} samples over {scene.duration:g} s",
        "integrator": f"{cost.integrator}, {cost.steps} steps of {cost.step_s:.4g} s",
        "estimated error": f"{error.total:.2g}{parts} (tolerance {tolerance:g})",
        "time spent": f"{cost.integration_s:.3g} s integration, {cost.estimate_s:.3g} s error estimate, "
        f"{cost.setup_s:.3g} s set-up",
        "file": str(path),
    }
    return "\n".join(f"{key:<16} {value}" for key, value in lines.items())


def _compare(arguments: argparse.Namespace) -> int:
    names, scene, picture, numbers, _ = _gather(
        lambda: _names(arguments.engines),
        lambda: _read(arguments.scene),
        lambda: arguments.output and _output(arguments.output, arguments.scene, PICTURES),
        lambda: arguments.json and _output(arguments.json, arguments.scene),
        lambda: _check_tolerance(arguments.tolerance),
    )
    from . import engines
    from .measure.compare import compare

    able = {}
    refusals: list[tuple[str, str]] = []
    for name in names:
        reasons = engines.get(name).refuses(scene)
        refusals += [(key, f"{name}: {reason}") for key, reason in reasons]
        if not reasons:
            able[name] = name
    if not able:
        raise InputError(refusals)
    trajectories, failures = _answers(scene, list(able), arguments.tolerance)
    if trajectories:
        comparison = compare(trajectories, _reference(scene, arguments.tolerance))
        print(comparison.table())
    for key, reason in refusals:
        print(f"left out: {reason} ({key})")
    if trajectories and numbers:
        _write_json(comparison.to_json(), numbers)
        print(f"numbers: {numbers}")
    if trajectories and picture:
        from .plotting import save

        save(comparison.plot(), picture)
        print(f"picture: {picture}")
    for failure in failures:
        _complain(failure)
    return 1 if failures else 0


def _names(given: str | None) -> list[str]:
    from . import engines

    if given is None:
        return list(engines.names())
    chosen = list(dict.fromkeys(name.strip() for name in given.split(",") if name.strip()))
    known = ", ".join(engines.names())
    if faults := [("engines", f"no engine is called {n!r}; use {known}") for n in chosen if n not in engines.names()]:
        raise InputError(faults)
    if not chosen:
        raise InputError([("engines", f"names none; use {known}")])
    return chosen


def _answers(scene: Scene, names: list[str], tolerance: float) -> tuple[list[Trajectory], list[str]]:
    """Run every engine; return the answers and what went wrong, in words."""
    from .simulation import simulate

    trajectories, failures = [], []
    for name in names:
        try:
            trajectories.append(simulate(scene, name, tolerance, progress=sys.stderr.isatty()))
        except ToleranceNotMet as error:
            failures.append(f"{name}: {error.reason}")
            if error.trajectory is not None:
                trajectories.append(error.trajectory)
        except (RunFailed, EngineUnavailable) as error:
            failures.append(f"{name}: {error}")
    return trajectories, failures


def _reference(scene: Scene, tolerance: float) -> Reference:
    """Return the truth: from an integrator apart, or from the native engine where that would take too long."""
    from .reference import Reference, expected_seconds, reference
    from .scene import Scene
    from .simulation import simulate

    if expected_seconds(scene) <= REFERENCE_S:
        return reference(scene)
    tight = max(tolerance / 100, TIGHTEST)
    everywhere = Scene(chain=scene.chain, excitation=scene.excitation, duration=scene.duration, samples=scene.samples)
    try:
        truth = simulate(everywhere, "native", tight, progress=sys.stderr.isatty())
    except ToleranceNotMet as error:
        if error.trajectory is None:
            raise
        truth = error.trajectory
    method = f"the native engine at a tolerance of {tight:g} (too long a scene for an integrator apart)"
    return Reference(truth.time, truth.displacement, truth.velocity, truth.error_estimate.total, method)


def _write_json(data: dict[str, Any], path: Path) -> None:
    import json

    from .files import write_aside

    with write_aside(path) as aside:
        aside.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _deck(arguments: argparse.Namespace) -> int:
    scene, _ = _gather(lambda: _read(arguments.scene), lambda: _check_tolerance(arguments.tolerance))
    from shlex import quote

    from .engines.lammps.export import write_deck

    folder = Path(arguments.output)
    write_deck(
        scene,
        folder,
        tolerance=arguments.tolerance,
        step=arguments.step,
        diameter=arguments.diameter,
        integrator=arguments.integrator,
        pair_style=arguments.pair_style,
    )
    print(f"wrote {folder / 'in.column'} and {folder / 'column.data'}; to run them:")
    print(f"  cd {quote(str(folder))} && lmp -in in.column")
    return 0


if __name__ == "__main__":
    sys.exit(main())
