"""Display at prompts, in notebooks and in `help`; sizes of pictures; public names of modules."""

import contextlib
import importlib
import inspect
import io
import re
import warnings
from collections.abc import Callable
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot

import lmpchain
from lmpchain import Chain, Drive, Force, Impulse, Scene, Trajectory, simulate
from lmpchain.measure import contact, energy, front, spectrum
from lmpchain.measure.fit import fit_bessel, fit_continuum, fit_exponents, fit_modes
from lmpchain.measure.fit.inverse import ParameterFit
from lmpchain.measure.fit.overview import summary
from lmpchain.orbits import normal_mode
from lmpchain.simulation.planner import Plan
from lmpchain.theory import bands, dimer_soliton, scattering, soliton
from lmpchain.util.plotting import COLOURS
from lmpchain.util.progress import RATE, ProgressBar

CHAIN = Chain(grains=40, diameter=1e-3)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-5), duration=1.2e-4, samples=121)
LOADED = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}


@pytest.fixture(scope="module")
def wave() -> Trajectory:
    return simulate(SCENE, "native", 1e-8)


class Seen(HTMLParser):
    """Parser for the texts and pictures in HTML, with a check that elements are closed in order."""

    def __init__(self, html: str):
        super().__init__()
        self.texts: list[str] = []
        self.pictures = 0
        self.open: list[str] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.pictures += 1
            assert dict(attrs)["alt"]
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("chain", "6.94554e-10 m"),
        ("scene", "0.09892"),
        ("plan", "modes"),
        ("trajectory", "native, which solves Eq. (1)"),
        ("front", "'velocity'"),
        ("summary", "energy of all modes"),
    ],
)
def test_a_notebook_shows_a_table_and_a_picture(wave: Trajectory, name: str, said: str):
    made: dict[str, Callable[[], Any]] = {
        "chain": lambda: CHAIN,
        "scene": lambda: SCENE,
        "plan": lambda: lmpchain.plan(SCENE),
        "trajectory": lambda: wave,
        "front": lambda: front.track(wave),
        "summary": lambda: summary(wave),
    }
    value = made[name]()
    seen = Seen(value._repr_html_())
    assert seen.texts[0] == type(value).__name__
    assert any(said in text for text in seen.texts)
    assert seen.pictures == (name != "summary")
    assert len(repr(value)) < 600
    assert "\n" not in repr(value)


def test_a_fitted_parameter_is_shown_in_a_line():
    unused: Any = None
    fitted = ParameterFit("velocity", 8.01234e-4, 2e-7, unused, unused, 3e-7, SCENE, 7)
    assert repr(fitted) == (
        "ParameterFit(velocity = 0.00080123 ± 2e-07 m/s, residual 3e-07, 7 runs)"
    )


def test_a_chain_of_millions_is_displayed_at_once():
    chain = Chain(grains=10**7, diameter=1e-7)
    assert repr(chain) == "Chain(grains=10000000, diameter=1e-07)"
    assert Seen(chain._repr_html_()).pictures == 0
    assert "masses" not in vars(chain)


def test_markup_in_values_is_escaped():
    odd = lmpchain.Material(
        density=1.0, youngs_modulus=1e9, poissons_ratio=0.3, name="<script>alert(1)</script>"
    )
    html = odd._repr_html_()
    assert "<script>" not in html
    assert any("<script>alert(1)</script>" in text for text in Seen(html).texts)


def test_a_table_contains_the_docstring_texts(wave: Trajectory):
    texts = Seen(energy.ledger(wave)._repr_html_()).texts
    assert texts[texts.index("time") + 2] == "Times, s"


def test_every_plot_has_ax_and_returns_axes():
    found = {Chain, Scene, Trajectory, Plan}
    packages = "measure", "measure.fit", "theory", "disorder", "orbits", "benchmark", "stability"
    for package in packages:
        folder = importlib.import_module(f"lmpchain.{package}")
        for path in Path(folder.__path__[0]).glob("[a-z]*.py"):
            module = importlib.import_module(f"{folder.__name__}.{path.stem}")
            found |= {c for c in vars(module).values() if isinstance(c, type) and "plot" in vars(c)}
    assert len(found) >= 25
    for kind in found:
        signature = inspect.signature(kind.plot)
        assert signature.parameters["ax"].default is None, kind
        assert signature.return_annotation == "Axes", kind
        assert kind.__repr__.__qualname__ in (
            "Shown.__repr__",
            "Checked.__repr__",
            "Trajectory.__repr__",
            "Averages.__repr__",
            "ParameterFit.__repr__",
        ), kind


def test_pictures_are_known_to_pyplot_and_given_axes_are_not_replaced(wave: Trajectory):
    ax = wave.plot()
    assert pyplot.get_fignums() == [ax.figure.number]
    assert wave.plot(ax=ax) is ax
    assert front.track(wave).plot(ax) is ax
    assert len(pyplot.get_fignums()) == 1


def test_the_palette_is_preserved_and_a_second_line_has_the_next_colour():
    ax = SCENE.plot()
    SCENE.replace(excitation=Impulse(velocity=2e-5)).plot(ax=ax)
    assert [line.get_color() for line in ax.lines] == list(COLOURS.values())[:2]


def overlap(a: Any, b: Any) -> bool:
    """Return whether two boxes overlap by more than 2 pixels in both directions."""
    return min(a.x1, b.x1) - max(a.x0, b.x0) > 2 and min(a.y1, b.y1) - max(a.y0, b.y0) > 2


def all_drawn(t: Trajectory) -> dict[str, Callable[..., Any]]:
    """Return every picture of one panel."""
    first = front.track(t)
    host = Chain(grains=9, **LOADED, impurity=[{"grain": 5, "diameter": 2e-3}])
    uniform = Chain(grains=40, **LOADED)
    struck = Scene(
        chain=uniform, excitation=Impulse(velocity=1e-7), duration=20 * uniform.time_scale
    )
    cell = Chain(grains=2, **LOADED | {"diameter": [1e-3, 2e-3]})
    return {
        "chain": CHAIN.plot,
        "scene": SCENE.plot,
        "force": SCENE.replace(
            excitation=Force(shape="half-sine", amplitude=0.1, duration=3e-5)
        ).plot,
        "plan": lmpchain.plan(SCENE).plot,
        "trajectory": t.plot,
        "front": first.plot,
        "power": front.asymptotic(first, "amplitude", 1.5).plot,
        "exponents": front.exponent(first).plot,
        "ledger": energy.ledger(t).plot,
        "contacts": contact.contacts(t).plot,
        "sensor": contact.sensor(t, 5).plot,
        "spectrum": spectrum.spectrum(t).plot,
        "dispersion": spectrum.dispersion(t, 2, 30).plot,
        "modes": fit_modes(t).plot,
        "residual": lambda ax: fit_modes(t).plot(ax, what="residual"),
        "continuum": fit_continuum(t).plot,
        "fit of exponents": fit_exponents(t, first=5).plot,
        "bessel": fit_bessel(simulate(struck, "native", 1e-9)).plot,
        "soliton": soliton.solve(speed=1.2).plot,
        "dimer": dimer_soliton.solve(0.3).plot,
        "bands": bands.branches(cell, np.linspace(-np.pi, np.pi, 101)).plot,
        "transmission": scattering.transmission(
            host, np.linspace(0.1, 0.9, 50) * 2 / uniform.time_scale
        ).plot,
        "orbit": normal_mode(Chain(grains=4, **LOADED), 1, 1e-9).plot,
        "drive": SCENE.replace(excitation=Drive(amplitude=1e-9, frequency=1e4)).plot,
    }


@pytest.mark.slow
def test_four_pictures_fit_a_page_of_7_by_5_inches(wave: Trajectory, tmp_path: Path):
    every = all_drawn(wave)
    names = list(every)
    faults = []
    for first in range(0, len(names), 4):
        here = names[first : first + 4]
        picture = pyplot.figure(figsize=(7, 5), layout="constrained")
        axes = picture.subplots(2, 2).ravel()[: len(here)]
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # A layout that does not fit causes a warning.
            for name, ax in zip(here, axes, strict=True):
                assert every[name](ax=ax) is ax, name
            picture.savefig(tmp_path / f"{first}.png")
        boxes = [ax.get_tightbbox() for ax in axes]
        for place, (name, box, ax) in enumerate(zip(here, boxes, axes, strict=True)):
            if min(box.x0, box.y0) < -3 or box.x1 > 703 or box.y1 > 503:
                faults.append(f"{name} leaves the page: {box}")
            if any(overlap(box, other) for other in boxes[:place]):
                faults.append(f"{name} lies over another")
            size = ax.get_window_extent()
            if min(size.width, size.height) < 85:
                faults.append(f"{name}: {size.width:.0f} x {size.height:.0f} pixels are left")
            ticks = [tick.get_window_extent() for tick in ax.get_xticklabels() if tick.get_text()]
            within = [one for one in ticks if size.x0 - 2 <= (one.x0 + one.x1) / 2 <= size.x1 + 2]
            if any(overlap(*pair) for pair in pairwise(sorted(within, key=lambda one: one.x0))):
                faults.append(f"{name}: the labels of its ticks lie over each other")
    assert faults == []


MODULES = [
    *("", "measure", "measure.front", "measure.energy", "measure.spectrum", "theory"),
    *("theory.bessel", "engines", "disorder", "orbits", "design", "chain", "chain.patterns"),
    *("scene", "trajectory", "stability"),
]


@pytest.mark.parametrize("name", MODULES)
def test_a_module_lists_only_its_public_names(name: str):
    module = importlib.import_module(f"lmpchain.{name}".rstrip("."))
    names = dir(module)
    assert names
    foreign = {"np", "annotations", "dataclass", "TYPE_CHECKING", "Any", "Array", "attributes"}
    assert not foreign & set(names)
    assert not [one for one in names if one.startswith("_")]
    assert all(
        inspect.getdoc(value)
        for value in (getattr(module, one) for one in names)
        if callable(value)
    )


@pytest.mark.parametrize("kind", [Chain, Scene, Impulse, Drive])
def test_help_begins_with_the_arguments(kind: type):
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        help(kind)
    opening = re.sub(".\b", "", text.getvalue()).split(inspect.getdoc(kind).splitlines()[0])[0]
    assert "Annotated" not in opening
    assert len(opening) < 700
    assert re.search(rf"{kind.__name__}\([\s|]*\*,[\s|]*{next(iter(kind.arguments))}\b", opening)
    arguments = [*kind.arguments, *kind.other_arguments]
    assert list(inspect.signature(kind).parameters) == arguments


def test_the_bar_of_a_fast_run_ends_at_100_percent(capsys: pytest.CaptureFixture[str]):
    with ProgressBar(7, "quick", layout=RATE) as bar:
        bar.advance(0.5)
    assert "quick: 100%" in capsys.readouterr().err
    with pytest.raises(KeyError), ProgressBar(7, "stopped", layout=RATE):
        raise KeyError
    assert "stopped: 100%" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_plot_shows_once_in_a_notebook(monkeypatch: pytest.MonkeyPatch):
    """A real kernel shows one picture when it is drawn, and none when it is only saved.

    With and without a semicolon.
    """
    nbclient = pytest.importorskip("nbclient", reason="nbclient comes with lmpchain[docs]")
    from nbformat.v4 import new_code_cell, new_notebook

    monkeypatch.delenv("MPLBACKEND", raising=False)  # The kernel chooses the backend.
    column = (
        "Scene(chain=Chain(grains=9, diameter=1e-3), excitation=Impulse(velocity=1e-5), "
        "duration=2e-5)"
    )
    pictures = {
        "import lmpchain\nfrom matplotlib import pyplot\nfrom lmpchain import *": 0,
        f"run = simulate({column}, 'native')": 0,
        "run.plot()": 1,
        "run.plot();": 1,
        "figure, both = pyplot.subplots(1, 2)\nrun.plot(ax=both[0])": 1,
        "lmpchain.plan(run.scene)": 0,
        "run": 0,
    }
    book = new_notebook(cells=[new_code_cell(cell) for cell in pictures])
    nbclient.NotebookClient(book, timeout=600, kernel_name="python3").execute()
    shown = [[out.get("data", {}) for out in cell.outputs] for cell in book.cells]
    assert [sum("image/png" in data for data in cell) for cell in shown] == list(pictures.values())
    tables = [sum("<img" in data.get("text/html", "") for data in cell) for cell in shown]
    assert tables == [0, 0, 0, 0, 0, 1, 1]
