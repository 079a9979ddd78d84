"""The command `docs`: open the documentation."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from ..errors import LmpchainError

SOURCES = Path(__file__).parent.parent.parent / "docs"  # Only in a checkout.


def docs(arguments: argparse.Namespace) -> int:
    """Open the built documentation in a browser, and print its location."""
    page = SOURCES / "build" / "index.html"
    if not page.is_file():
        build = f"pip install -e '.[docs]' && sphinx-build {SOURCES} {SOURCES / 'build'}"
        raise LmpchainError(
            f"the pages are not built: {build}; or read {SOURCES / 'index.md'}"
            if SOURCES.is_dir()
            else "this installation has no pages: they are in the folder docs of the source code"
        )
    print(page.as_uri())
    webbrowser.open(page.as_uri())
    return 0
