"""Locks of folders, also on file systems without locks."""

import errno
import fcntl
import os
from pathlib import Path

import pytest

from lmpchain.util.files import UNSUPPORTED, describe_holder, take_lock


@pytest.fixture(params=UNSUPPORTED, ids=errno.errorcode.get)
def without_flock(request, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr(fcntl, "flock", refuse)


def taken_by_another_process(folder: Path) -> bool:
    child = os.fork()
    if child == 0:
        os._exit(take_lock(folder) is not None)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1


@pytest.mark.usefixtures("without_flock")
def test_a_file_is_the_lock_without_flock(tmp_path: Path):
    lock = take_lock(tmp_path)
    assert lock is not None
    assert not taken_by_another_process(tmp_path)
    said = describe_holder(tmp_path)
    assert said.startswith(f"process {os.getpid()} on {os.uname().nodename} ")
    assert f"remove {tmp_path}" in said
    lock.release()
    assert taken_by_another_process(tmp_path)


def test_a_lock_of_the_system_names_no_process(tmp_path: Path):
    lock = take_lock(tmp_path)
    assert lock is not None
    assert not taken_by_another_process(tmp_path)
    assert describe_holder(tmp_path) == "another process"
