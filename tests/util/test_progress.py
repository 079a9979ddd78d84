"""Progress bars, short forms of values, and announcements and timing of compilation."""

import base64
import gc
import html
import importlib.util
import inspect
import io
import pickle
import re
import struct
import sys
import threading
import time
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.bytecode import FunctionIdentity
from numba.core.event import end_event, start_event

from lmpchain.util import compilation
from lmpchain.util.notebook import Shown, brief, parse_meanings
from lmpchain.util.progress import COUNT, RATE, ProgressBar


class Tqdm:
    """Stub of tqdm that records the calls of its bar."""

    def __init__(self, **options: Any):
        self.options = options
        self.n = options["initial"]
        self.total = options["total"]
        self.calls: list[Any] = []

    def update(self, amount: float) -> None:
        self.n += amount
        self.calls.append(amount)

    def refresh(self) -> None:
        self.calls.append(("shown", self.n))

    def close(self) -> None:
        self.calls.append("closed")

    def set_description_str(self, text: str) -> None:
        self.calls.append(text)

    def set_postfix_str(self, text: str, refresh: bool) -> None:
        self.calls.append((text, refresh))


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> list[Tqdm]:
    """Record the bars instead of showing them."""
    made: list[Tqdm] = []
    monkeypatch.setattr(
        "tqdm.auto.tqdm", lambda **options: made.append(Tqdm(**options)) or made[-1]
    )
    return made


def test_a_bar_counts_finished_work(bars: list[Tqdm]):
    with ProgressBar(7, "engines", " samples", done=2, layout=RATE) as bar:
        bar.advance()
        bar.advance(0.5)
        bar.reach(6.0)
        bar.describe("native")
        bar.remark("slow")
    (shown,) = bars
    options = {"total": 7, "desc": "engines", "unit": " samples", "initial": 2, "leave": False}
    assert shown.options == options | {"bar_format": RATE, "delay": 0.0}
    assert shown.calls == [1, 0.5, 2.5, "native", ("slow", False), ("shown", 7), "closed"]
    with ProgressBar(3):
        pass
    options = {"total": 3, "desc": "", "unit": "", "initial": 0, "leave": False}
    assert bars[1].options == options | {"bar_format": COUNT, "delay": 0.0}
    with ProgressBar(3, shown=False) as bar:
        bar.advance()
        bar.reach(2)
        bar.describe("a")
        bar.remark("b")
    assert len(bars) == 2


# --- short forms of values


class Few(Shown):
    """A value with fields of many types.

    Attributes
    ----------
    size, width : float
        In metres,
        on two lines.
    name : str
        Of it.
    """

    def __init__(self, count: int):
        self.size = 1 / 3
        self.name = "n" * 88
        self.longer = "n" * 89
        self._hidden = 1
        for number in range(count):
            setattr(self, f"more{number}", number)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1 / 3, "0.333333"),
        (np.float32(0.5), "0.5"),
        (np.arange(4), "[0 1 2 3]"),
        (np.arange(5), "(5,) from 0 to 4"),
        (np.array([1 / 3, 1.0]), "[0.33333 1.     ]"),
        (np.array([[1.5, np.nan], [-2.0, np.inf]]), "(2, 2) from -2 to 1.5"),
        (np.array([-0.0] * 5), "(5,) from 0 to 0"),
        (np.array([np.nan, np.inf]), "[nan inf]"),
        (np.full((9, 9), np.nan), "(9, 9)"),
        (np.array([3 + 4j] * 5), "(5,) from 5 to 5"),
        ([1, 2, 3, 4], "[1, 2, 3, 4]"),
        ([1] * 5, "5 values"),
        ({"a": 1}, "{'a': 1}"),
        (dict.fromkeys(range(5)), "5 values"),
        ((1 / 3, "a"), "(0.333333, 'a')"),
        ((Few(0),), "1 values"),
        ("x" * 58, repr("x" * 58)),
        ("x" * 59, "'" + "x" * 55 + " ..."),
    ],
)
def test_the_short_form_of_a_value(value: Any, text: str):
    assert brief(value) == text


def test_a_value_shows_eight_fields_in_a_line():
    text = repr(Few(20))
    assert text.startswith("Few(size=0.333333, name='nnn")
    assert text.count("=") == 8
    assert "more4=4" in text
    assert "_hidden" not in text


def test_a_table_has_names_values_and_meanings():
    cells = re.findall("<td[^>]*>(.*?)</td>", Few(1)._repr_html_())
    assert [html.unescape(cell) for cell in cells] == [
        *("size", "0.333333", "In metres, on two lines"),
        *("name", repr("n" * 88), "Of it"),
        *("longer", "'" + "n" * 85 + " ...", ""),
        *("more0", "0", ""),
    ]
    assert parse_meanings(inspect.getdoc(Few))["width"] == "", "said of the first"
    page = Few(0)._repr_html_()
    assert page.startswith("<div><b>Few</b><table><tr><td style=")
    assert page.endswith("</table></div>"), "without a picture"
    assert page.count("<td") == 9


def test_a_small_picture_is_720_by_450_pixels():
    drawn: list[Any] = []

    class Drawn(Few):
        def plot(self, ax: Any) -> None:
            drawn.append(ax.figure.get_size_inches().tolist())

    text = Drawn(0)._repr_html_().partition('<img alt="Drawn"')[2].partition(";base64,")[2]
    content = base64.b64decode(text.partition('"')[0])
    assert drawn == [[4.8, 3.0]]
    assert struct.unpack(">II", content[16:24]) == (720, 450)


# --- compilation


def module(folder: Path, name: str, text: str) -> ModuleType:
    (folder / f"{name}.py").write_text(text)
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    assert spec
    assert spec.loader
    made = importlib.util.module_from_spec(spec)
    sys.modules[name] = made
    spec.loader.exec_module(made)
    return made


TOY = """
from lmpchain.util.compilation import compiled_once

@compiled_once("the toys of {name}", 3, error_model="numpy")
def half(x):
    return x / 0.0

@compiled_once("the toys of {name}", 3)
def twice(x):
    return 2 * x
"""


def test_a_compilation_is_announced_once_and_timed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    toy = module(tmp_path, "toy_announced", TOY.format(name="one"))
    before = compilation.compiled_s()
    assert toy.half(1.0) == np.inf, "options are those of numba"
    assert compilation.compiled_s() > before
    message = "compiling the toys of one, once for this machine: about 3 s\n"
    assert capsys.readouterr().err == message
    assert toy.twice(2.0) == 4.0
    assert capsys.readouterr().err == ""
    begun = time.perf_counter()
    now = compilation.clock() + compilation.compiled_s()
    assert begun <= now <= time.perf_counter()
    folder = numba.config.CACHE_DIR or tmp_path
    assert list(Path(folder).rglob("toy_announced.half-*.nbc"))
    del sys.modules["toy_announced"]


def test_a_long_compilation_has_a_bar_on_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    terminal = io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    toy = module(tmp_path, "toy_with_bar", TOY.format(name="another"))
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        assert toy.twice(2) == 4
        assert "%" not in terminal.getvalue(), "it was short"
        patch.setattr(compilation, "LONG_S", 0)
        assert toy.half(2) == np.inf
    assert "\rcompiling:   0% |" in terminal.getvalue()
    del sys.modules["toy_with_bar"]


def test_the_bar_of_nested_compilations_follows_the_clock(
    bars: list[Tqdm], monkeypatch: pytest.MonkeyPatch
):
    """Garbage is collected less often meanwhile; a function without a job changes no bar."""
    terminal = io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", terminal)
    now = SimpleNamespace(s=10.0)
    clocks = SimpleNamespace(perf_counter=lambda: now.s, thread_time=lambda: 0.0)
    monkeypatch.setattr(compilation, "time", clocks)
    before, collected = gc.get_threshold(), (700, 11, 12)
    gc.set_threshold(*collected)

    def at(second: float, change: Any, function: Any) -> None:
        now.s = second
        change("numba:compile", {"dispatcher": SimpleNamespace(py_func=function)})

    def long() -> None:
        pass

    def other() -> None:
        pass

    compilation.compiled_once("what is long", 30)(long)
    for end in (50.0, 25.0):
        at(9.0, start_event, other)
        at(9.5, end_event, other)
        at(10.0, start_event, long)
        assert gc.get_threshold() == (500_000, 11, 12)
        at(11.0, start_event, long)
        at(12.0, end_event, long)
        at(13.0, start_event, other)
        at(14.0, end_event, other)
        at(end, end_event, long)
        assert gc.get_threshold() == collected
    assert terminal.getvalue() == "compiling what is long, once for this machine: about 30 s\n"
    for bar, last in zip(bars, (26.0, 11.0), strict=True):
        assert (bar.total, bar.options["delay"]) == (30, 3)
        assert bar.calls == [2.0, 2.0, last, "closed"]

    def quiet() -> None:
        compilation.announce_nothing()
        compilation.compiled_once("what is quiet", 30)(other)
        at(60.0, start_event, other)
        at(61.0, end_event, other)
        assert "quiet" not in terminal.getvalue()

    process = get_context("fork").Process(target=quiet)
    process.start()
    process.join()
    assert process.exitcode == 0
    gc.set_threshold(*before)


def test_uncached_code_is_compiled_in_every_process(capsys: pytest.CaptureFixture[str]):
    names: dict[str, Any] = {}
    exec(compile("def third(x):\n    return x / 3", "<no file>", "exec"), names)
    third = compilation.compiled_once("what has no file", 3)(names["third"])
    assert third(3.0) == 1.0
    said = capsys.readouterr().err
    assert said.startswith(
        "compiling what has no file, in every process, because no folder is writable"
    )
    assert said.endswith(": about 3 s\n")


def test_the_stopwatch_counts_nested_compilations_once(monkeypatch: pytest.MonkeyPatch):
    now = SimpleNamespace(s=10.0)
    # On a busy machine, a second gives half a second of CPU time.
    clocks = SimpleNamespace(perf_counter=lambda: now.s, thread_time=lambda: now.s / 2)
    monkeypatch.setattr(compilation, "time", clocks)
    before, cpu_before = compilation.compiled_s(), compilation.compiled_cpu_s()

    def at(second: float, change: Any) -> None:
        now.s = second
        change("numba:compiler_lock")

    at(11.0, start_event)
    at(12.0, start_event)
    at(14.0, end_event)
    at(17.0, end_event)
    assert compilation.compiled_s() - before == pytest.approx(6.0)
    at(20.0, start_event)
    at(20.5, end_event)
    assert compilation.compiled_s() - before == pytest.approx(6.5)
    assert compilation.compiled_cpu_s() - cpu_before == pytest.approx(3.25)
    assert compilation.clock() == pytest.approx(20.5 - compilation.compiled_s())
    elsewhere: list[float] = []
    spent = compilation.compiled_s, compilation.compiled_cpu_s
    thread = threading.Thread(target=lambda: elsewhere.extend(each() for each in spent))
    thread.start()
    thread.join()
    assert elsewhere == [0.0, 0.0]


def test_the_cache_key_depends_on_imported_neighbours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    imports = "from .beside import called\nfrom .none import nothing\n"
    imports += "from ...integrators.kernels.kernel import called"
    texts = {
        "toy": f'{TOY.format(name="two")}"""\n{imports}\n"""',
        "beside": "from .deep import called",
        "deep": "called = 1\nfrom .toy import x",
        "other": "called = 1",
        "kernel": "called = 1",
    }

    def stamp(folder: str, **changed: str) -> str:
        (tmp_path / folder).mkdir()
        monkeypatch.setattr(compilation, "KERNELS", tmp_path / folder)
        for name, text in (texts | changed).items():
            (tmp_path / folder / f"{name}.py").write_text(text)
        toy = module(tmp_path / folder, "toy", (texts | changed)["toy"])
        return toy.half._cache._cache_file._version.split()[-1]

    first = stamp("a")
    assert stamp("b", other="called = 2") == first
    for name in ("toy", "beside", "deep", "kernel"):
        texts_of = {name: f"{texts[name]}\n# changed"}
        assert len({stamp(f"{name} changed", **texts_of), first}) == 2
    del sys.modules["toy"]


@pytest.mark.parametrize("gone", ["clmpchain.errors\nGone\n.", "clmpchain.gone\nGone\n."])
def test_code_cached_by_an_older_version_is_recompiled(gone: str, tmp_path: Path):
    """A stale cache is ignored before numba unpickles argument types that no longer exist."""
    toy = module(tmp_path, "toy_outdated", TOY.format(name="three"))
    file = toy.twice._cache._cache_file
    path = Path(file._index_path)
    path.parent.mkdir(exist_ok=True)
    older = file._version[:-1]  # The sources of that version were different.
    path.write_bytes(pickle.dumps(older, protocol=-1) + gone.encode())
    assert file._load_index() == {}
    assert toy.twice(3.0) == 6.0
    assert file._load_index()
    del sys.modules["toy_outdated"]


def test_damaged_code_is_ignored_with_one_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    toy = module(tmp_path, "toy_damaged", TOY.format(name="four"))
    assert toy.twice(3.0) == 6.0
    file = toy.twice._cache._cache_file
    index = Path(file._index_path)
    ((key, name),) = file._load_index().items()
    code = Path(file._data_path(name))
    data = file.load(key)
    whole = {path: path.read_bytes() for path in (code, index)}
    bit = bytes([whole[code][-1] ^ 1])
    limit = "compiled code cannot be used or stored there \\(.*set NUMBA_CACHE_DIR"
    for path, content in (
        (code, whole[code][:-1] + bit),
        (code, whole[code][:-9]),
        (code, b"not found"),
        (index, whole[index][:-9]),
        (index, bytes(len(whole[index]))),
        (index, b""),
    ):
        monkeypatch.setattr(compilation, "_complained", set())
        path.write_bytes(content)
        with pytest.warns(UserWarning, match=rf"^{path}: {limit}") as warned:
            assert (file.load(key), file.load(key)) == (None, None)
        assert len(warned) == 1
        file.save(key, data)
        assert file.load(key)[0] == data[0]
    # Nothing is stored on a full disk.
    monkeypatch.setattr(compilation, "_complained", set())
    index.unlink()
    index.mkdir()
    with pytest.warns(UserWarning, match=rf"{limit}"):
        file.save(key, data)
    del sys.modules["toy_damaged"]


def test_compiled_functions_of_two_processes_have_different_names():
    """Numba alone counts functions from 1 in each process."""
    numbers = [FunctionIdentity.from_function(module).unique_id for _ in range(4)]
    assert len(set(numbers)) == 4
    assert max(numbers) > 2**56
    assert min(numbers) >= 0
