"""Argument parser that reports faults in the same format as all commands."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping
from typing import Any, NoReturn

from ..errors import SHOWN_LETTERS, short
from ..util.suggestions import did_you_mean
from .common import complain


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
