"""The state of a folder after a kill: copies from before every change that a process makes."""

import os
import random
import shutil
import sys
import threading
from collections.abc import Callable, Container
from contextlib import suppress
from pathlib import Path
from typing import Self

CHANGES = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate"}
_watches: list["Watch"] = []  # At most one watch at a time.
_turn = threading.RLock()
_hooked: list[bool] = []


class Watch:
    """Counts the changes to a folder, and copies the folder before some of them."""

    def __init__(self, folder: Path, wanted: Container[int], into: Path):
        self.count = 0
        self.copies = []
        self._folder = folder
        self._wanted = wanted
        self._into = into
        self._again = False

    def __enter__(self) -> Self:
        if not _hooked:
            sys.addaudithook(_look)  # The hook stays, because audit hooks cannot be removed.
            _hooked.append(True)
        _watches.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _watches.clear()

    def look(self, words: list[str]) -> None:
        """Register a change that involves these paths."""
        if self._folder.exists() and any(str(self._folder) in word for word in words):
            if self.count in self._wanted or self._again:
                # The change is registered at the next event if another thread is moving a file.
                self._again = True
                with suppress(shutil.Error):
                    self.copies.append(shutil.copytree(self._folder, self._into / str(self.count)))
                    self._again = False
            self.count += 1


def kill_moments(
    folder: Path, work: Callable[[], object], most: int, rng: random.Random, into: Path
) -> list[Path]:
    """Do some work twice; return copies of its folder as after kills at its changes."""
    before = folder.with_name(f"{folder.name} before")
    if folder.exists():
        shutil.copytree(folder, before)
    with Watch(folder, (), into) as watch:
        work()
    shutil.rmtree(folder)
    if before.exists():
        before.rename(folder)
    with Watch(folder, rng.sample(range(watch.count), min(most, watch.count)), into) as watch:
        work()
    return watch.copies


def _look(event: str, arguments: tuple) -> None:
    if not _watches or event not in CHANGES:
        return
    if event == "open" and not (
        isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
    ):
        return
    with _turn:
        if _watches:
            watch = _watches.pop()  # Changes by the copies themselves are not changes of the work.
            try:
                watch.look(
                    [os.fsdecode(each) for each in arguments if isinstance(each, str | bytes)]
                )
            finally:
                _watches.append(watch)
