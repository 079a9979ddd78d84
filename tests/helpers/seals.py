"""Seals of files that tests modify."""

from pathlib import Path

from lmpchain.util.files import seal


def seal_anew(path: Path) -> None:
    """Seal a file as lmpchain does, so that it is read instead of being rejected by its seal."""
    content = path.read_bytes()
    path.write_bytes(content + seal(content))
