"""Seals of files that tests have changed."""

from pathlib import Path

from lmpchain.util.files import seal


def seal_anew(path: Path) -> None:
    """Seal a file as lmpchain does, so that it is read and not refused unopened."""
    content = path.read_bytes()
    path.write_bytes(content + seal(content))
