"""Steps that several commands share: reading scenes, checking output paths, writing results."""

from __future__ import annotations

import argparse
import os
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TextIO

from ..errors import InputError, either

# Heavy modules are imported inside the functions, so that wrong input is reported at once.
if TYPE_CHECKING:
    from ..scene.scene import Scene

STANDARD = "-"  # Stands for standard input or standard output in place of a file name.
STDOUT = Path("/dev/stdout")  # Path that `output` returns for standard output.
PICTURES = (".png", ".pdf", ".svg")
MESSAGE_WIDTH = 80  # Columns of an error message on a terminal.
# Standard output of a command that writes data; the text of the command goes to standard error.
_data: ContextVar[TextIO | None] = ContextVar("data", default=None)
KIND_STYLES = {"error": "bold red", "fault": "bold red", "warning": "bold yellow", "ok": "green"}


def complain(text: str, kind: str = "error") -> None:
    """Print a fault on stderr, in one line unless it is a terminal; escape unprintable letters."""
    # A file name may contain a line break, or a code that moves the cursor.
    letters = (
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in " ".join(text.split())
    )
    message = f"{kind}: {''.join(letters)}"
    if on_terminal():
        message = textwrap.fill(
            message,
            MESSAGE_WIDTH,
            subsequent_indent="  ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    show(kind, message.removeprefix(kind), sys.stderr)


def show(kind: str, text: str, stream: TextIO | None) -> None:
    """Print a line that begins with its kind, in colour on a terminal, unless NO_COLOR is set."""
    # A closed stream is None.
    if stream is None or not stream.isatty():
        print(f"{kind}{text}", file=stream, flush=True)
        return
    from rich.console import Console
    from rich.text import Text

    line = Text.assemble((kind, KIND_STYLES[kind]), text)
    Console(file=stream, highlight=False).print(line, soft_wrap=True)


def on_terminal() -> bool:
    """Return whether stderr is a terminal, where progress is shown."""
    return sys.stderr is not None and sys.stderr.isatty()


def collect(*checks: Callable[[], Any]) -> list[Any]:
    """Call all checks and return their results; raise one `InputError` with all faults."""
    results = []
    faults = []
    # All checks run, so that the user sees all faults at once.
    for check in checks:
        try:
            results.append(check())
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return results


def read_scene(path: str) -> Scene:
    """Return the scene of a file, or of standard input with files in the current folder."""
    from ..scene.scene import Scene

    if path != STANDARD:
        return Scene.from_toml(path)
    from ..scene.toml_file import parse_text

    return Scene.from_dict(parse_text(sys.stdin.read(), "standard input"))


@contextmanager
def data_apart(arguments: argparse.Namespace) -> Iterator[None]:
    """Send the text of a command to standard error if its data go to standard output."""
    written = [getattr(arguments, name, None) for name in ("json", "output", "new_scene")]
    if STANDARD not in written:
        yield
        return
    if written.count(STANDARD) > 1:
        raise InputError.at(STANDARD, "names standard output twice; name a file for one of them")
    before = _data.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _data.reset(before)


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Yield the path of a text file to write; copy its text to standard output for `STDOUT`."""
    if path != STDOUT:
        yield path
        return
    with TemporaryDirectory() as folder:
        aside = Path(folder) / "text"
        yield aside
        print(aside.read_text(encoding="utf-8"), end="", file=_data.get())


def output(
    name: str,
    scene: str,
    suffixes: Sequence[str] = (),
    *,
    force: bool = False,
    stream: bool = False,
) -> Path:
    """Return the path of a file to write, after checking that it can be written.

    A file that lmpchain did not write is replaced only with `force`. With `stream`, the name "-"
    means standard output.
    """
    from ..util.files import expanded, is_foreign

    if name == STANDARD:
        if not stream:
            raise InputError.at(name, "is standard output, which only accepts text: name a file")
        return STDOUT
    path = expanded(name)
    source = expanded(scene)
    _check_file(name, path, "" if suffixes else "run.nc")
    if suffixes and path.suffix.lower() not in suffixes:
        endings = either(suffixes)
        raise InputError.at(name, f"must end in {endings}")
    if path.exists() and source.exists() and path.samefile(source):
        raise InputError.at(name, "is the input file: name another file")
    if not path.parent.is_dir():
        raise InputError.at(name, f"there is no folder {path.parent}: create it first")
    # The folder must accept a new file, because outputs are written beside the target and renamed.
    writable = os.access(path.parent, os.W_OK | os.X_OK)
    if not writable or (path.exists() and not os.access(path, os.W_OK)):
        raise InputError.at(name, "you may not write there; choose another place")
    if not force and is_foreign(path):
        raise InputError.at(
            name,
            "is a file that lmpchain did not write: name another file, or replace it with --force",
        )
    return path


def _check_file(name: str, path: Path, example: str) -> None:
    """Raise `InputError` if a path is a folder, a device or a pipe."""
    if path.is_dir() or name.endswith(("/", os.sep)):
        raise InputError.at(name, f"is a folder; name a file, such as {path / example}")
    if path.exists() and not path.is_file():
        raise InputError.at(name, "is a device or a pipe, not a file; name a file")


def check_outputs(arguments: Any, source: str) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """Return checks of the paths of picture and numbers, for `collect`; None for unused options."""
    return (
        lambda: (
            arguments.output and output(arguments.output, source, PICTURES, force=arguments.force)
        ),
        lambda: check_numbers(arguments, source),
    )


def check_numbers(arguments: Any, source: str) -> Path | None:
    """Return the checked path of the numbers, `STDOUT` for "-", or None without this option."""
    if not arguments.json:
        return None
    return output(arguments.json, source, force=arguments.force, stream=True)


def beside(path: str, suffix: str) -> str:
    """Return the name of a file beside another."""
    return os.path.splitext(path)[0] + suffix


def write_json(data: dict[str, Any], path: Path, what: str = "numbers") -> None:
    """Write numbers as JSON to a path that `output` has checked, and print the path."""
    import json

    from ..util.files import write_aside

    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    with written(path) as file, write_aside(file, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    if path != STDOUT:
        print(f"{what}: {path}")


def keep(result: Any, numbers: Path | None, picture: Path | None, *arguments: Any) -> None:
    """Write the numbers and the picture of a result to paths that `output` has checked, if any."""
    if numbers:
        write_json(result.to_json(*arguments), numbers)
    if picture:
        import matplotlib

        from ..util.plotting import save

        # A command must not open a window.
        matplotlib.use("agg")
        save(result.plot(*arguments), picture, overwrite=True)
        print(f"picture: {picture}")
