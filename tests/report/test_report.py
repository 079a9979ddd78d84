"""The page about a run: a single file with the numbers of the run."""

import base64
import hashlib
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import browser, installed
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from helpers.live_figure import arrays, numbers_of

from lmpchain import Drive, Force, Impulse, InputError, Packet, Trajectory, simulate
from lmpchain import report as htmlreport
from lmpchain.cli.command_line import main
from lmpchain.measure.spectrum import travel_time
from lmpchain.report import document
from lmpchain.report.document import origin, title
from lmpchain.report.panels import arrival
from lmpchain.report.verdicts import front_below
from lmpchain.util.provenance import command


class Page(HTMLParser):
    """The visible content of a page: headings with the text below them, and pictures."""

    def __init__(self, text: str):
        super().__init__()
        self.sections: dict[str, str] = {}
        self.pictures: list[bytes] = []
        self.links: list[str] = []
        self.scripts: list[dict] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img", "input"):
            self.open.append(tag)
        known = dict(attrs)
        self.links += [known[key] for key in ("src", "href") if key in known]
        if tag == "script":
            self.scripts.append(known)
        if tag == "img":
            kind, data = known["src"].split(",", 1)
            assert kind == "data:image/svg+xml;base64"
            assert len(known["alt"]) > 40, "it says what is seen"
            self.pictures.append(base64.b64decode(data))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, "every element is closed in its turn"

    def handle_data(self, data):
        self.texts.append(data)
        if self.open and self.open[-1] == "h2":
            self.sections[data] = ""
        elif self.sections and not {"footer", "script"} & set(self.open):
            self.sections[list(self.sections)[-1]] += data


@pytest.fixture(scope="module")
def text(wave: Trajectory) -> str:
    return htmlreport.page(wave)


@pytest.fixture
def no_panels(monkeypatch: pytest.MonkeyPatch):
    """Omit the slow pictures in tests about other parts."""
    monkeypatch.setattr(document, "PANELS", {})


def test_a_whole_page(wave: Trajectory, text: str):
    page = Page(text)
    assert page.open == []
    panels = "Waveforms, The front, Spectra, Dispersion, Contacts, Energy"
    texts = "Fits, The run, Provenance, How to cite, The scene"
    assert ", ".join(page.sections) == f"The wave in space and time, {panels}, {texts}"
    assert len(page.pictures) == 7
    assert all(b"<svg" in picture for picture in page.pictures)
    assert all(link.startswith("data:") for link in page.links), "nothing is fetched from elsewhere"
    facts = " ".join(page.texts[: page.texts.index("The wave in space and time")])
    numbers = f"{wave.scene.strike_number:.3g}", f"{wave.error_estimate.total:.2g}"
    for said in (*numbers, "Eq. (1)", "1e-09", "not recorded"):
        assert said in facts
    assert f"{np.abs(wave.displacement).max():.6g} m" in page.sections["The run"]
    assert wave.provenance["numba"] in page.sections["Provenance"]
    assert "energy of all modes" in page.sections["Fits"]
    assert "velocity = 0.001" in page.sections["The scene"]
    assert "Not for this run" not in text


def test_titles_distinguish_runs(wave: Trajectory):
    scene = wave.scene
    others = [
        scene.replace(excitation=Impulse(velocity=2e-3)),
        scene.replace(duration=5e-5),
        scene.replace(chain=scene.chain.replace(gravity=98.1)),
        scene.replace(excitation=Force(shape="half-sine", amplitude=0.1, duration=3e-5)),
    ]
    titles = {title(wave)} | {
        title(Trajectory(**{**vars(wave), "scene": other})) for other in others
    }
    assert len(titles) == 5


def test_the_live_view_contains_the_motion(wave: Trajectory, text: str):
    live = arrays(numbers_of(text))
    there = np.searchsorted(wave.time, live["time"] * (1 - 1e-8))
    shown = wave.velocity[np.ix_(there, live["grains"] - 1)]
    assert np.abs(live["velocity"] - shown).max() < np.abs(shown).max() / 60000
    assert live["grains"][0] == 1
    assert 10 < live["grains"][-1] < 40, "grains that the wave has not reached are left out"
    first = np.abs(wave.velocity[:, 9]).argmax()
    assert live["law"][9] == pytest.approx(wave.time[first], rel=0.2)
    assert live["front"][9] == pytest.approx(wave.time[first], abs=wave.time[1])
    kinetic = 0.5 * (wave.scene.chain.masses * wave.velocity**2).sum(1)[there]
    assert live["kinetic"] == pytest.approx(kinetic, abs=kinetic.max() / 6e4)
    # Energy is conserved: the strike provides all of it.
    assert live["total"] == pytest.approx(kinetic[0], rel=1e-4)
    linear = simulate(wave.scene, "modes").velocity[np.ix_(there, live["grains"] - 1)]
    assert live["linear"] == pytest.approx(linear, abs=np.abs(linear).max() / 5e4)


@pytest.mark.parametrize(("grains", "duration", "samples"), [(500, 1e-3, 201), (300, 5e-4, 101)])
def test_an_unresolved_front_is_not_denied(grains: int, duration: float, samples: int):
    """Samples 5 us apart do not show the order of the peaks."""
    scene = scene_of(column(grains), Impulse(velocity=8.57e-4), duration, samples)
    run = simulate(scene, "native", 1e-6)
    with pytest.raises(InputError, match=r"samples: .* record \d+ samples") as refusal:
        front_below(run)
    needed = int(re.findall(r"record (\d+)", str(refusal.value))[0])
    finer = simulate(scene.replace(samples=needed), "native", 1e-6)
    track = front_below(finer)
    # The front travels about as far and as fast as a long weak wave.
    expected = travel_time(scene.chain)[track.grain - 1]
    assert track.grain[-1] == pytest.approx((expected <= duration).sum(), abs=track.grain.size / 5)
    assert np.mean(np.diff(track.time) > 0) > 0.9
    assert track.time[-1] == pytest.approx(expected[-1], rel=0.05)


def test_only_a_real_front_is_reported(wave: Trajectory):
    assert "weak wave deep in the column" in arrival(wave).caption
    for excitation in (
        Drive(amplitude=1e-9, frequency=1e4),
        Packet(frequency=2e4, width=2, grain=20, amplitude=1e-12),
    ):
        with pytest.raises(InputError, match="no single front"):
            arrival(simulate(wave.scene.replace(excitation=excitation), "chebyshev"))
    with pytest.raises(InputError, match="no front of the velocity passes"):
        arrival(simulate(wave.scene.replace(excitation=Impulse(velocity=0.0)), "native", 1e-6))


def test_missing_parts_state_the_reason():
    chain = column(12, gravity=0.0, bottom="free")
    scene = scene_of(chain, Impulse(velocity=1e-2), 5e-5, 40, grains=[2, 5])
    page = Page(htmlreport.page(simulate(scene, "native", 1e-6)))
    missing = "Not for this run: grains: "
    assert f"{missing}no two neighbouring grains were recorded" in page.sections["Contacts"]
    assert f"{missing}some grains that are needed were not recorded" in page.sections["Energy"]
    assert "left out: modes" in page.sections["Fits"]
    assert 1 <= len(page.pictures) <= 5


@pytest.mark.slow
def test_the_page_of_a_chain_at_rest():
    scene = scene_of(column(5), Impulse(velocity=0.0), 1e-5, 5)
    page = Page(htmlreport.page(simulate(scene, "native", 1e-6)))
    assert "strongest" not in page.sections["Fits"]


@pytest.mark.usefixtures("no_panels")
def test_markup_in_a_scene_is_escaped(wave: Trajectory):
    odd = "</script><script>alert(1)</script><img src=x onerror=alert(1)>"
    spoilt = Trajectory(
        **{**vars(wave), "provenance": {"note": odd, "tolerance": odd}, "engine": odd}
    )
    text = htmlreport.page(spoilt, origin={"date": odd, "command": odd})
    page = Page(text)
    assert odd in page.sections["Provenance"]
    assert page.texts.count(odd) >= 4
    assert len(page.scripts) == 2
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert (
        policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{digest}'"
    )


@pytest.mark.usefixtures("no_panels")
def test_command_line(wave: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wave.save(tmp_path / "run.nc")
    assert main(["report", str(tmp_path / "run.nc")]) == 0
    page = Page((tmp_path / "run.html").read_text(encoding="utf-8"))
    assert page.pictures
    assert page.texts[page.texts.index("Command") + 1] == command()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", page.texts[page.texts.index("Date") + 1])
    assert main(["report", str(tmp_path / "run.nc"), "-o", str(tmp_path / "other.html")]) == 0
    assert (tmp_path / "other.html").exists()
    capsys.readouterr()
    for file, page, fault in (
        ("none.nc", "page.html", "there is no such file"),
        ("run.nc", "page.txt", "must end in .html or .htm"),
        ("run.nc", "no/page.html", "there is no folder"),
    ):
        assert main(["report", str(tmp_path / file), "-o", str(tmp_path / page)]) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert fault in said


def test_a_run_folder_states_its_date_and_command(wave: Trajectory, tmp_path: Path):
    simulate(wave.scene, "native", 1e-6, folder=tmp_path / "run")
    found = origin(tmp_path / "run")
    assert found["command"] == command()
    (tmp_path / "run" / "run.json").write_text("[" * 100000)
    assert origin(tmp_path / "run")["command"] == "not recorded"
    assert origin(tmp_path / "none") == {"date": "not recorded", "command": "not recorded"}


SAID = "document.getElementById('said').textContent"
SPOKEN = "document.getElementById('said').getAttribute('aria-live')"
FOCUS = "document.activeElement.id"
COLOURS = """(() => {
  const map = document.getElementById("map");
  const all = map.getContext("2d").getImageData(0, 0, map.width, map.height);
  return new Set(new Uint32Array(all.data.buffer)).size;
})()"""
PLACE = (
    "(({x, y, width, height}) => [x, y, width, height])"
    "(document.getElementById('map').getBoundingClientRect())"
)


@pytest.mark.slow
@pytest.mark.skipif(not installed(), reason="no Chromium is installed here")
def test_in_a_browser(wave: Trajectory, tmp_path: Path):
    page = tmp_path / "page.html"
    odd = (
        "</script><script>document.title = 'obeyed'</script>"
        "<img src=x onerror=\"document.title = 'obeyed'\">"
    )
    htmlreport.write(wave, page, origin={"date": odd, "command": odd})
    with browser(tmp_path / "profile") as shown:
        for width, height, scheme in ((1280, 900, "light"), (390, 844, "dark")):
            shown.open(page, width, height, scheme)
            shown.wait_for("document.documentElement.dataset.ready")
            assert shown.run("document.title") == title(wave)
            assert shown.run("document.documentElement.scrollWidth") == width, (
                "nothing is wider than the window"
            )
            assert shown.run(
                "[...document.images].every((one) => one.complete && one.naturalWidth > 0)"
            )
            assert shown.run(COLOURS) > 100, "the map has colours"
            small = (
                "[...document.querySelectorAll('button, input, summary')]"
                ".some((one) => one.offsetHeight < 44)"
            )
            assert not shown.run(small), "what is pressed is as large as a finger"
            shown.press("Tab")
            assert shown.run(FOCUS) == "map"
            grain = int(shown.run(SAID).split()[1])
            shown.press("ArrowDown")
            assert shown.run(SAID).startswith(f"Grain {grain + 1} at 30 µs: ")
            for _ in range(2):
                shown.press("ArrowLeft")
            speed = float(f"{wave.velocity[58, grain] * 1e6:.3g}")
            said = f"Grain {grain + 1} at 29 µs: {speed:g} µm/s".replace("-", "−")
            assert shown.run(SAID).startswith(f"{said}, linear theory ")
            shown.press("Tab")
            assert shown.run(FOCUS) == "play"
            shown.press(" ", " ")
            playing = "document.getElementById('play').textContent"
            assert shown.run(playing) == "Pause"
            assert shown.run(SPOKEN) == "off", "a reader of the screen does not read every time"
            later = f"new Promise((done) => setTimeout(() => done({SAID}), 400))"
            first = shown.run(SAID)
            assert shown.run(later) != first, "the numbers follow the motion"
            shown.press(" ", " ")
            assert shown.run(playing) == "Play"
            assert shown.run(SPOKEN) == "polite"
            shown.press("Tab")
            before = shown.run(SAID).split()[3]
            shown.press(" ", " ")
            assert float(shown.run(SAID).split()[3]) < float(before), "one time back"
            for stop in ("forward", "time"):
                shown.press("Tab")
                assert shown.run(FOCUS) == stop
            shown.run("document.getElementById('map').scrollIntoView()")
            left, top, across, _ = shown.run(PLACE)
            shown.point(left + across / 2, top + 22)
            assert shown.run(SAID).startswith("Grain 1 at ")
            assert shown.remarks == []
