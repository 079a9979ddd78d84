"""Files are written completely or not at all, and are read as written."""

import errno
import hashlib
import os
import platform
import re
from io import BytesIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_output import names
from helpers.faults import faults

from lmpchain import InputError
from lmpchain.util import files
from lmpchain.util.files import (
    check_not_foreign,
    check_readable,
    check_seal,
    check_tree,
    is_foreign,
    is_lock,
    make_folder,
    path_of,
    read_sealed_json,
    replacing,
    seal,
    sealed_json,
    take_lock,
    unpack,
    unpack_one,
    write_aside,
)

NO_PROCESS = 2**22 + 1  # Above the largest process number, PID_MAX_LIMIT of Linux.


# --- atomic writing


def test_a_file_appears_under_its_name_when_it_is_complete(tmp_path: Path):
    path = tmp_path / "run.nc"
    path.write_text("before")
    with replacing(path) as aside:
        aside.write_text("after")
        assert path.read_text() == "before"
        assert aside.parent == tmp_path
        assert aside.name.startswith(".")
        assert aside.suffix == ".nc"
    assert path.read_text() == "after"
    assert names(tmp_path) == ["run.nc"]


def test_a_failed_write_preserves_the_earlier_file(tmp_path: Path):
    path = tmp_path / "run.nc"
    path.write_text("before")

    def fail(aside: Path) -> None:
        aside.write_text("half")
        raise KeyError

    with pytest.raises(KeyError), replacing(path) as aside:
        fail(aside)
    assert path.read_text() == "before"
    assert names(tmp_path) == ["run.nc"]


def test_content_is_on_disk_before_the_name(tmp_path: Path, monkeypatch: Any):
    path = tmp_path / "run.nc"
    flushed = []

    def flush(descriptor: int) -> None:
        flushed.append((os.fstat(descriptor).st_ino, path.exists()))

    monkeypatch.setattr(os, "fsync", flush)
    opened = len(os.listdir("/proc/self/fd"))
    with replacing(path) as aside:
        aside.touch()
    assert flushed == [(path.stat().st_ino, False), (tmp_path.stat().st_ino, True)]
    assert len(os.listdir("/proc/self/fd")) == opened


def test_a_file_of_another_process_is_not_removed(tmp_path: Path):
    begun = get_context("fork").Event()

    def write() -> None:
        assert begun.wait(600)
        with replacing(tmp_path / "b.nc") as aside:
            aside.write_text("of the other")

    # The other process has not written to this folder before.
    process = get_context("fork").Process(target=write, daemon=True)
    process.start()
    with replacing(tmp_path / "a.nc") as aside:
        aside.write_text("of this one")
        begun.set()
        process.join()
    assert process.exitcode == 0
    assert (tmp_path / "a.nc").read_text() == "of this one"
    assert names(tmp_path) == ["a.nc", "b.nc"]


def test_unfinished_files_of_killed_processes_are_removed(tmp_path: Path):
    here = platform.node()
    dead = f".run.{here}-{NO_PROCESS}-0123abcd.partial.nc"
    kept = [
        f".run.elsewhere-{NO_PROCESS}-0123abcd.partial.nc",
        f".run.{here}-{os.getpid()}-0123abcd.partial.nc",
        f".run.{here}-{NO_PROCESS}-0123abc.partial.nc",
        f".run.{here}-{NO_PROCESS}-0123abcd.nc",
    ]
    for name in (dead, *kept):
        (tmp_path / name).touch()
    with replacing(tmp_path / "new") as aside:
        aside.touch()
    assert names(tmp_path) == sorted([*kept, "new"])


def test_the_partial_file_contains_the_process_number(tmp_path: Path):
    with replacing(tmp_path / "run.nc") as first, replacing(tmp_path / "run.nc") as second:
        assert first != second
        for aside in (first, second):
            aside.touch()
            pattern = (
                rf"\.run\.{re.escape(platform.node())}-{os.getpid()}-[0-9a-f]{{8}}\.partial\.nc"
            )
            assert re.fullmatch(pattern, aside.name)


@pytest.mark.parametrize(
    "failure", [OSError(errno.ENOSPC, "No space left"), RuntimeError("No space left")]
)
def test_a_write_error_states_the_reason(tmp_path: Path, failure: Exception):
    path = tmp_path / "run.nc"
    with pytest.raises(InputError) as caught, write_aside(str(path)):
        raise failure
    assert caught.value.faults == [(str(path), "cannot be written: No space left")]


def test_only_regular_files_are_overwritten(tmp_path: Path):
    with pytest.raises(InputError) as caught, write_aside(tmp_path):
        pass
    assert caught.value.faults == [(str(tmp_path), "is a folder or a device; name a file")]
    path = tmp_path / "none" / "run.nc"
    with pytest.raises(InputError) as caught, write_aside(path):
        pass
    assert caught.value.faults == [(str(path), "cannot be written: No such file or directory")]
    with pytest.raises(KeyError), write_aside(tmp_path / "run.nc"):
        raise KeyError
    for text in ("first", "second"):
        with write_aside(tmp_path / "run.nc") as aside:
            aside.write_text(text)
        assert (tmp_path / "run.nc").read_text() == text


def test_a_folder_is_made_with_its_parents(tmp_path: Path):
    folder = tmp_path / "a" / "b"
    for _ in range(2):
        assert make_folder(str(folder)) == folder
        assert folder.is_dir()
    (folder / "file").touch()
    fault = "is not a folder and cannot be made one: File exists"
    assert faults(make_folder, folder / "file") == [(str(folder / "file"), fault)]


# --- readable files


def test_files_are_read_up_to_a_size_limit(tmp_path: Path):
    path = tmp_path / "data"
    path.write_bytes(bytes(3 * 2**20))
    check_readable(path, 3 * 2**20)
    with pytest.raises(OSError, match=r"^\[Errno 27\] is larger than 3 MB$") as caught:
        check_readable(path, 3 * 2**20 - 1)
    assert caught.value.errno == errno.EFBIG
    os.mkfifo(tmp_path / "pipe")
    for odd in (tmp_path, tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(OSError, match="is not a file, but a folder, a device") as caught:
            check_readable(odd, 2**20)
        assert caught.value.errno == errno.EINVAL


def test_a_tree_of_folders_may_not_contain_links(tmp_path: Path, monkeypatch: Any):
    tree = tmp_path / "tree"
    (tree / "inner").mkdir(parents=True)
    (tree / "inner" / "file").touch()
    check_tree(tree)
    (tmp_path / "link").symlink_to(tree)
    with pytest.raises(OSError, match="link is a link; name what it points to"):
        check_tree(tmp_path / "link")
    for odd in ("file link", "folder link", "pipe"):
        path = tree / "inner" / odd
        if odd == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to(tmp_path if odd == "folder link" else tree / "inner" / "file")
        with pytest.raises(OSError, match=f"{odd} in it is a link, a device or a pipe"):
            check_tree(tree)
        path.unlink()
    # A file that a run renames meanwhile is skipped, but the next file is checked.
    os.mkfifo(tree / "pipe")
    monkeypatch.setattr(os, "walk", lambda at: [(at, [], ["gone"])])
    check_tree(tree)
    monkeypatch.setattr(os, "walk", lambda at: [(at, [], ["gone", "pipe"])])
    with pytest.raises(OSError, match="pipe in it is"):
        check_tree(tree)


def test_a_seal_is_the_hash_of_the_content(tmp_path: Path):
    content = bytes(range(256)) * 3
    path = tmp_path / "run.nc"
    assert seal(content)[-32:] == hashlib.sha256(content).digest()
    whole = content + seal(content)
    path.write_bytes(whole)
    check_seal(path)
    # Files of other programs, and truncated files.
    for unsealed in (content, b"", b"short", whole[:-1], whole + b" "):
        path.write_bytes(unsealed)
        with pytest.raises(ValueError, match="ends without the seal of lmpchain"):
            check_seal(path)
    for place in (0, len(content) - 1, len(whole) - 1, len(whole) - 32):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="it was changed after it was written"):
            check_seal(path)


ARRAYS = {
    "table": np.arange(12.0).reshape(3, 4),
    "number": np.array(-2.5),
    "names": np.array(["a", "grain"]),
    "none": np.zeros((0, 3), dtype=int),
}


def test_arrays_are_preserved(tmp_path: Path):
    packed = BytesIO()
    np.savez(packed, **ARRAYS)
    (tmp_path / "part.npz").write_bytes(packed.getvalue())
    arrays = unpack(packed.getvalue())
    assert list(arrays) == list(ARRAYS)
    for name, values in ARRAYS.items():
        for array in (arrays[name], unpack_one(tmp_path / "part.npz", name)):
            assert array.dtype == values.dtype
            assert np.array_equal(array, values)
            assert array.shape == values.shape
            assert array.flags.writeable


@pytest.mark.parametrize("how", ["compressed", "objects", "columns first"])
def test_arrays_other_than_plain_ones_are_rejected(tmp_path: Path, how: str):
    values = {
        "compressed": np.zeros((2, 3)),
        "objects": np.array([print, None]),
        "columns first": np.asfortranarray(ARRAYS["table"]),
    }[how]
    packed = BytesIO()
    (np.savez_compressed if how == "compressed" else np.savez)(packed, values=values)
    (tmp_path / "part.npz").write_bytes(packed.getvalue())
    reason = "compressed arrays" if how == "compressed" else "arrays that are not plain"
    with pytest.raises(ValueError, match=reason):
        unpack(packed.getvalue())
    with pytest.raises(ValueError, match=reason):
        unpack_one(tmp_path / "part.npz", "values")


def test_one_array_of_a_file_is_read(tmp_path: Path):
    with pytest.raises(OSError, match="is not a file, but a folder"):
        unpack_one(tmp_path, "values")


# --- files of the user


def test_only_files_of_lmpchain_are_replaced(tmp_path: Path):
    ours, theirs, empty, link, none = (
        tmp_path / name for name in ("ours", "theirs", "empty", "link", "none")
    )
    with write_aside(ours) as path:
        path.write_text("ours")
    theirs.write_text("theirs")
    empty.touch()
    link.symlink_to(ours)
    assert [is_foreign(path) for path in (none, empty, theirs, link)] == [False, False, True, True]
    sealed = tmp_path / "sealed"
    sealed.write_bytes(b"content" + seal(b"content"))
    assert not is_foreign(sealed)
    for path in (theirs, link):
        with pytest.raises(InputError, match="is a file that lmpchain did not write: name another"):
            check_not_foreign(path, overwrite=False)
        check_not_foreign(path, overwrite=True)
    if hasattr(os, "getxattr") and files.WRITTEN in os.listxattr(ours):
        assert not is_foreign(ours)
        ours.write_text("ours, edited")
        assert is_foreign(ours)


def test_a_sealed_record_is_read_as_written(tmp_path: Path, monkeypatch: Any):
    path = tmp_path / "store.json"
    record = {"name": "run", "sizes": [1, 2.5], "none": None}
    text = sealed_json(record | {"seal": "an old one"})
    path.write_text(text)
    assert read_sealed_json(path) == record
    with monkeypatch.context() as patch:
        patch.setattr(files, "LARGEST_JSON", len(text) - 1)
        assert read_sealed_json(path) is None
    for other in (text.replace("2.5", "2.6"), "[1]", "{}", text[:-3], "[" * 10**5):
        path.write_text(other)
        assert read_sealed_json(path) is None
    assert read_sealed_json(tmp_path) is None
    assert read_sealed_json(tmp_path / "none") is None
    with pytest.raises(ValueError, match="JSON"):
        sealed_json({"x": np.inf})


def test_names_that_cannot_be_paths_are_named(tmp_path: Path, monkeypatch: Any):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert path_of("~/a") == path_of(tmp_path / "a") == tmp_path / "a"
    assert path_of("~nobody-of-this-name/a") == Path("~nobody-of-this-name/a")
    for name, fault in (
        (3, "must be a name in quotes (got 3)"),
        ("", "must be a name in quotes (got '')"),
        ("a\0b", "cannot be used: "),
        ("a" * 300, "cannot be used: File name too long"),
    ):
        with pytest.raises(InputError, match=re.escape(fault)) as caught:
            path_of(name, "output")
        assert caught.value.faults[0][0] == "output"


def test_locks_of_others_are_not_taken(tmp_path: Path):
    path = tmp_path / files.LOCK
    assert is_lock(path)
    for content, ours in ((b"", True), (b"12\nhost\n", True), (b"12\n" + b"a" * 1000, False)):
        path.write_bytes(content)
        assert is_lock(path) == ours
    path.write_text("a diary")
    assert not is_lock(path)
    with pytest.raises(InputError, match="is not a lock of lmpchain, but a link, a device or a fi"):
        take_lock(tmp_path)
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").touch()
    assert not is_lock(path)
    path.unlink()
    path.mkdir()
    assert not is_lock(path)
    opened = len(os.listdir("/proc/self/fd"))
    assert files.has_locks(tmp_path)
    assert len(os.listdir("/proc/self/fd")) == opened
