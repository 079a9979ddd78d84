"""Options that print text for a shell: the completion script and the manual page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from typing import Any

from .common import complain

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
