"""The command line: parses the arguments of a verb, runs its function and reports faults.

Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 75 the time
limit --max-wall was reached before the end of the run, 130 after Ctrl-C, 143 after SIGTERM.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import io
import os
import re
import resource
import signal
import sys
import textwrap
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from typing import Any, NoReturn

from ..errors import SHOWN_LETTERS, InputError, LmpchainError, did_you_mean, short
from ..util import mpi
from .common import complain, data_apart
from .run import resume, run, run_folder, sweep
from .verbs import GROUPS, VERBS

SHELLS = ("bash", "zsh", "tcsh")
# Marks of metavars whose values are files or folders, such as SCENE.toml and FOLDER/.
OF_FILES = (".", "FILE", "FOLDER", "DUMP")


class PrintCompletion(argparse.Action):
    """Option that prints the completion script of a shell for commands, options and files."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, shell: Any, *__: Any) -> None:
        """Print the script and exit; shtab is imported here because it is optional."""
        try:
            import shtab
        except ModuleNotFoundError:
            complain("--print-completion: requires shtab: pip install 'lmpchain[completion]'")
            parser.exit(1)
        commands = _commands(parser)
        # shtab omits actions that the help does not show, and the help lists commands by groups.
        commands.help = "command"
        for command in commands.choices.values():
            for action in command._actions:
                if _is_file(action):
                    action.complete = shtab.FILE  # type: ignore[attr-defined]
        print(shtab.complete(parser, shell))
        parser.exit()


class PrintManual(argparse.Action):
    """Option that prints the manual page, which `man` shows."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the page and exit."""
        sys.stdout.write("\n".join(_manual(parser)) + "\n")
        parser.exit()


def _commands(parser: argparse.ArgumentParser) -> Any:
    """Return the argparse action that selects the command; its `choices` are the subparsers."""
    return next(each for each in parser._actions if isinstance(each, argparse._SubParsersAction))


def _is_file(action: argparse.Action) -> bool:
    """Return whether the value of an argument is a file or a folder."""
    return isinstance(action.metavar, str) and any(part in action.metavar for part in OF_FILES)


def _manual(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the lines of the manual page in the roff format of `man`."""
    yield '.TH LMPCHAIN 1 "" "lmpchain" "User Commands"'
    yield ".SH NAME"
    yield r"lmpchain \- waves in columns of Hertzian grains"
    yield ".SH SYNOPSIS"
    yield ".B lmpchain"
    yield r".RI [ options ] " + '" " COMMAND " " ' + r"[ arguments ]"
    yield ".SH DESCRIPTION"
    for paragraph in (parser.description or "").split("\n\n"):
        # A group of commands is a list, whose line breaks are preserved.
        listed = "\n  " in paragraph
        yield from (
            (".PP", ".nf", *map(_plain, paragraph.splitlines()), ".fi")
            if listed
            else (
                ".PP",
                _plain(paragraph),
            )
        )
    yield ".SH OPTIONS"
    yield from _arguments(parser)
    yield ".SH COMMANDS"
    for name, command in _commands(parser).choices.items():
        yield f".SS {_plain(name)}"
        yield _plain(command.description)
        yield f".PP\n.nf\n{_plain(command.epilog)}\n.fi"
        yield from _arguments(command)
    yield ".SH EXIT STATUS"
    yield _plain(parser.epilog or "")


def _arguments(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the arguments of a parser with their help."""
    formatter = parser._get_formatter()
    for action in parser._actions:
        if action.help != argparse.SUPPRESS:
            yield ".TP"
            yield rf"\fB{_plain(formatter._format_action_invocation(action))}\fR"
            yield _plain(formatter._expand_help(action) if action.help else "")


def _plain(text: str) -> str:
    """Return text escaped for `man`, so that a leading point is not a request."""
    escaped = " ".join(text.split(" ")).replace("\\", r"\e").replace("-", r"\-")
    lines = (rf"\&{line}" if line.startswith((".", "'")) else line for line in escaped.splitlines())
    return "\n".join(lines)


class Parser(argparse.ArgumentParser):
    """An argument parser that reports a fault in one line, without the usage message."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)
        # Earlier spellings of options that are still accepted.
        self.renamed: Mapping[str, str] = {}

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Report unknown arguments here, because only this parser has the command's options."""
        if args is not None:
            args = [self._current_spelling(each) for each in args]
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            options = self._option_string_actions
            cures = [did_you_mean(name.partition("=")[0], options) for name in unknown]
            cure = next(filter(None, cures), "")
            self.error(f"unrecognized arguments: {' '.join(unknown)}{cure}")
        return arguments, unknown

    def _current_spelling(self, word: str) -> str:
        """Return a word of the command line with an earlier spelling of an option replaced."""
        name, equals, value = word.partition("=")
        return self.renamed.get(name, name) + equals + value

    def print_help(self, file: Any = None) -> None:
        """Print the help; raise an error if the pipe is closed, which argparse may ignore."""
        print(self.format_help(), end="", file=file)

    def error(self, message: str) -> NoReturn:
        """Report a fault of the arguments in one line, and exit with code 2."""
        # The message of argparse lists all choices; the most similar one, if any, is enough.
        if choice := re.search(r"invalid choice: '(.*)'( \(choose from (.*)\))", message):
            similar = did_you_mean(choice[1], re.findall(r"[\w/-]+", choice[3]))
            message = message.replace(choice[2], similar or choice[2])
        # A long word, such as a scene in place of its file name, would hide the message.
        brief = re.sub(rf"\S{{{SHOWN_LETTERS},}}", lambda match: short(match[0]), message)
        named = brief.removeprefix("argument ")
        complain(f"{'arguments: ' if named == brief else ''}{named}; see {self.prog} --help")
        sys.exit(2)


class ShowVersion(argparse.Action):
    """Option that shows the version; the version is looked up only on demand."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the version and exit."""
        from importlib.metadata import version

        print(f"lmpchain {version('lmpchain')}")
        parser.exit()


# Most objects that a command creates at its start live to its end. Python's default frequency of
# garbage collection, and the collection at exit, would take a quarter of the time of a short run.
OBJECTS_BETWEEN_LOOKS = 20_000
# Threads of OpenBLAS spin for 2^26 cycles before they sleep. This value shortens the wait to a
# twentieth on each core.
BRIEF_WAITING = "OPENBLAS_THREAD_TIMEOUT", "20"


# If memory is limited, as by `ulimit -v`, OpenBLAS requests memory for its threads for ever, and
# Python waits for ever for a thread whose memory is refused: glibc reserves 64 MB for each thread.
SMALL_MEMORY = 2**32  # Bytes.
FOR_SMALL_MEMORY = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
# Number of the option MALLOC_ARENA_MAX in glibc; a running process no longer reads the variable.
M_ARENA_MAX = -8
HELP_WIDTH = 78  # Columns.
PURPOSE = (
    "Waves in columns of Hertzian grains: LAMMPS and a native integrator, side by side, each with "
    "an estimate of its own error. All quantities are in SI units. Begin with `lmpchain new "
    "scene.toml`. `lmpchain COMMAND --help` shows the options of a command."
)
EXIT_CODES = (
    "Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 75 the "
    "time limit --max-wall was reached before the end of the run, 130 after Ctrl-C, 143 after "
    "SIGTERM."
)


class _Terminated(BaseException):
    """Raised when SIGTERM arrives; not an `Exception`, so that no handler of faults catches it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; under mpirun, rank 0 runs it.

    Only a run in LAMMPS joins the processes of mpirun. A command that was started by a program
    under mpirun inherits the variables of mpirun, but is not one of its processes.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the name of the program; by default the arguments of the process.
    """
    gc.set_threshold(OBJECTS_BETWEEN_LOOKS)
    # A file name may contain letters that the encoding of the output lacks.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    atexit.register(gc.freeze)
    os.environ.setdefault(*BRIEF_WAITING)
    if 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < SMALL_MEMORY:
        for variable, value in FOR_SMALL_MEMORY.items():
            os.environ.setdefault(variable, value)
        import ctypes  # Most commands do not need it.

        with suppress(AttributeError):  # Other libraries reserve nothing.
            ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    if mpi.count_processes() > 1 and not _uses_ranks(argv):
        if mpi.is_launched() and not mpi.is_first():
            # Rank 0 does all the work.
            return 0
        mpi.leave()
        return _run(argv)
    if mpi.count_processes() == 1:
        return _run(argv)
    try:
        world = mpi.join()
    except LmpchainError as error:
        complain(str(error))
        return 1
    # LAMMPS is imported only here, because most commands do not need it.
    from ..engines.lammps.communicators import shutdown_workers, worker_loop

    # Ranks beyond the first only serve LAMMPS.
    if world.rank > 0:
        worker_loop(world)
        return 0
    try:
        return _run(argv)
    finally:
        # Without this call the other ranks would wait forever.
        shutdown_workers(world)


def _uses_ranks(argv: Sequence[str] | None) -> bool:
    """Return whether a command runs a scene in LAMMPS, which may use all processes of mpirun."""
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        try:
            arguments = _parser().parse_args(argv)
        except SystemExit:
            # The first process reports the faults of the arguments.
            return False
    from ..engines import class_of

    if arguments.command is resume:
        from ..simulation.folder_files import engine_of

        name = engine_of(arguments.folder)
    elif arguments.command is run:
        name = arguments.engine
    else:
        return False
    return class_of(name).ranks_of_mpi


def _run(argv: Sequence[str] | None) -> int:
    """Run the command line; exit silently if the reader of a pipe closes it, as `head` does."""
    try:
        code = _main(argv)
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                # Python sets a stream that was closed before the start to None.
                stream.flush()
        return code
    except BrokenPipeError:
        # Python flushes its streams at exit, and would fail again at the closed pipe.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            # The rest of the buffers goes to the null device at exit.
            with suppress(AttributeError, OSError, ValueError):
                os.dup2(nowhere, stream.fileno())
        # A shell reports this exit code for a program that SIGPIPE ends.
        return 128 + signal.SIGPIPE
    except OSError as error:
        # The disk behind stdout may be full.
        with suppress(OSError, ValueError):
            sys.stdout.close()
        complain(str(error))
        return 1


def _main(argv: Sequence[str] | None) -> int:
    try:
        arguments = _parser().parse_args(argv)
    # SystemExit comes from --help, --version, or faults that argparse has reported.
    except SystemExit as end:
        return int(end.code or 0)
    before = _on_sigterm(_raise_terminated)
    try:
        with warnings.catch_warnings():
            # A warning is printed as one line, without the line of Python code that raised it.
            warnings.showwarning = _show_warning  # type: ignore[assignment]
            with data_apart(arguments):
                return arguments.command(arguments)
    except InputError as error:
        for key, message in error.faults:
            complain(f"{key if key.strip() else repr(key)}: {message}")
        return 2
    except LmpchainError as error:
        complain(str(error))
        return 1
    except BrokenPipeError:
        # BrokenPipeError is an OSError but not a fault: `_run` exits silently.
        raise
    except OSError as error:
        complain(str(error))
        return 1
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "start new thread" not in str(error):
            raise
        complain("memory ran out: record fewer grains or samples, or use a shorter chain")
        return 1
    except KeyboardInterrupt:
        print(f"stopped by Ctrl-C; {_describe_rest(arguments)}", file=sys.stderr)
        return 130
    except _Terminated:
        print(f"stopped by SIGTERM; {_describe_rest(arguments)}", file=sys.stderr)
        return 143
    finally:
        _on_sigterm(before)


def _describe_rest(arguments: argparse.Namespace) -> str:
    """Return a sentence about the files that a stopped command has left behind."""
    from ..simulation.folder_files import is_run, resume_command

    if arguments.command is sweep:
        return f"finished scenes are kept in {arguments.output}; repeat the command to continue"
    folder = run_folder(arguments)
    if folder and is_run(folder):
        return f"continue with: {resume_command(folder)}"
    hint = (
        "; with -o FOLDER/ a stopped run is kept and can be resumed"
        if arguments.command is run
        else ""
    )
    return f"nothing unfinished was kept{hint}"


def _raise_terminated(*_: Any) -> None:
    raise _Terminated


def _on_sigterm(handler: Any) -> Any:
    """Install a handler of SIGTERM and return the previous one; only the main thread may do so."""
    if threading.current_thread() is not threading.main_thread():
        return None
    before = signal.getsignal(signal.SIGTERM)
    # None stands for a handler written in C, which Python cannot install again.
    signal.signal(signal.SIGTERM, signal.SIG_DFL if handler is None else handler)
    return before


def _show_warning(message: Warning | str, *_: Any) -> None:
    complain(str(message), "warning")


def _show_help(_: argparse.Namespace) -> int:
    """Print the help and return the exit code for wrong input, because a command is missing."""
    _parser().print_help()
    return 2


def _list_commands() -> Iterator[str]:
    """Yield each group of commands with their summaries, as a paragraph of the help."""
    for title, names in GROUPS.items():
        lines = [f"{title}:"]
        for name in names:
            lines += textwrap.wrap(
                VERBS[name].summary,
                HELP_WIDTH,
                initial_indent=f"  {name:<13}",
                subsequent_indent=" " * 15,
            )
        yield "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="lmpchain",
        usage="lmpchain [OPTION] COMMAND ...",
        description="\n\n".join([textwrap.fill(PURPOSE, HELP_WIDTH), *_list_commands()]),
        epilog=textwrap.fill(EXIT_CODES, HELP_WIDTH),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(command=_show_help)
    parser.add_argument(
        "-V", "--version", action=ShowVersion, nargs=0, help="show the version and exit"
    )
    parser.add_argument(
        "--print-completion",
        action=PrintCompletion,
        choices=SHELLS,
        help="print the script by which this shell completes commands and options, and exit",
    )
    parser.add_argument(
        "--print-manual",
        action=PrintManual,
        nargs=0,
        help="print the manual page for man, and exit",
    )
    verbs = parser.add_subparsers(metavar="COMMAND", prog="lmpchain", help=argparse.SUPPRESS)
    for name, verb in VERBS.items():
        sub = verbs.add_parser(
            name,
            help=verb.summary,
            description=f"{verb.summary[0].upper()}{verb.summary[1:]}.",
            epilog=f"Example: lmpchain {verb.example}",
        )
        sub.set_defaults(command=verb.command)
        sub.renamed = verb.renamed
        for names, options in verb.arguments:
            sub.add_argument(*names, **options)
        if verb.choice:
            group = sub.add_mutually_exclusive_group()
            for names, options in verb.choice:
                group.add_argument(*names, **options)
    return parser
