"""Suppressed warnings in threads: no thread loses warnings of another one, and filters stay."""

import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck

from lmpchain import simulate
from lmpchain.util.remarks import note, warn, warnings_aside

# This wave is far from linear, so Eq. (3) warns of its error.
STRONG = struck(column(6), 0.1, 2e-5, 5)


def in_threads(work: Callable[[int], Any], count: int = 8) -> None:
    """Call a function in several threads; raise the error of any thread."""
    faults: list[BaseException] = []

    def run(number: int) -> None:
        try:
            work(number)
        except BaseException as error:
            faults.append(error)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if faults:
        raise faults[0]


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.slow
def test_runs_in_folders_in_threads_leave_the_filters_of_python(tmp_path: Path):
    """Python's own suppression of warnings left the filter "ignore" behind."""
    # Libraries add their own filters when they are first used.
    simulate(STRONG, "chebyshev", folder=tmp_path / "first")
    before = list(warnings.filters)
    for round_number in range(3):
        in_threads(
            lambda number, at=round_number: simulate(
                STRONG, "chebyshev", folder=tmp_path / f"{at} {number}"
            )
        )
    assert list(warnings.filters) == before
    with pytest.warns(UserWarning, match=r"Eq\. \(3\) leaves out"):
        simulate(STRONG, "chebyshev")


def test_warnings_suppressed_in_one_thread_are_shown_in_another():
    put_aside = threading.Barrier(2)
    said = threading.Barrier(2)
    texts = []

    def quiet() -> None:
        with warnings_aside() as mine:
            put_aside.wait()
            said.wait()
            warn("not to be heard")
            texts.extend(mine)

    thread = threading.Thread(target=quiet)
    thread.start()
    put_aside.wait()
    with pytest.warns(UserWarning, match="to be heard") as heard:
        warn("to be heard")
    said.wait()
    thread.join()
    assert [str(warning.message) for warning in heard] == ["to be heard"]
    assert heard[0].filename == __file__
    assert texts == ["not to be heard"]


def test_a_note_is_one_line_on_stderr(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    note("a\nb \x1b[1mc, é")
    assert capsys.readouterr().err == "note: a\\nb \\x1b[1mc, é\n"
    with warnings_aside() as texts:
        note("suppressed")
    assert (capsys.readouterr().err, texts) == ("", [])
    # A program without a console has no stderr.
    monkeypatch.setattr("sys.stderr", None)
    note("lost")
