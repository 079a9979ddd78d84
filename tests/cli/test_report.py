"""The page about a run: one file, all of it inside, with the numbers of the run."""

import base64
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from lmpchain import Chain, Impulse, Scene, Trajectory, simulate
from lmpchain import report as htmlreport
from lmpchain.cli.command_line import main


class Page(HTMLParser):
    """What a reader sees: headings with the text below them, and pictures."""

    def __init__(self, text: str):
        super().__init__()
        self.sections: dict[str, str] = {}
        self.pictures: list[bytes] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img"):
            self.open.append(tag)
        known = dict(attrs)
        self.links += [known[key] for key in ("src", "href") if key in known]
        if tag == "img":
            kind, data = known["src"].split(",", 1)
            assert kind == "data:image/png;base64"
            assert known["alt"] == list(self.sections)[-1]
            self.pictures.append(base64.b64decode(data))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, "every element is closed in its turn"

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.sections[data] = ""
        elif self.sections and "footer" not in self.open:
            self.sections[list(self.sections)[-1]] += data


@pytest.fixture(scope="module")
def run() -> Trajectory:
    chain = Chain(grains=40, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=60e-6, samples=121)
    return simulate(scene, "native", 1e-8)


def test_a_whole_page(run: Trajectory):
    text = htmlreport.page(run)
    page = Page(text)
    assert page.open == []
    assert list(page.sections) == [
        "The run",
        "The wave in space and time",
        "Waveforms",
        "The front",
        "Spectra",
        "Contacts",
        "Energy",
        "Fits",
        "Provenance",
        "The scene",
    ]
    assert len(page.pictures) == 6
    assert all(picture.startswith(b"\x89PNG") for picture in page.pictures)
    assert all(link.startswith("data:") for link in page.links), "nothing is fetched from elsewhere"
    facts = page.sections["The run"]
    for number in (
        f"{run.scene.strike_number:.3g}",
        f"{run.error_estimate.total:.2g}",
        f"{np.abs(run.displacement).max():.6g} m",
        "Eq. (1)",
    ):
        assert number in facts
    assert run.provenance["numba"] in page.sections["Provenance"]
    assert "energy of all modes" in page.sections["Fits"]
    assert "velocity = 0.001" in page.sections["The scene"]
    assert "Not for this run" not in text


def test_what_does_not_apply_says_why():
    chain = Chain(grains=12, diameter=1e-3, gravity=0.0, bottom="free")
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-2), duration=5e-5, samples=40, grains=[2, 5])
    page = Page(htmlreport.page(simulate(scene, "native", 1e-6)))
    assert "Not for this run: grains: no two neighbours were recorded" in page.sections["Contacts"]
    assert "Not for this run: grains: this takes grains that were not recorded" in page.sections["Energy"]
    assert "left out: modes" in page.sections["Fits"]
    assert 1 <= len(page.pictures) <= 4


def test_the_page_of_a_chain_at_rest():
    scene = Scene(chain=Chain(grains=5, diameter=1e-3), excitation=Impulse(velocity=0.0), duration=1e-5, samples=5)
    page = Page(htmlreport.page(simulate(scene, "native", 1e-6)))
    assert "strongest" not in page.sections["Fits"]


def test_markup_in_a_scene_is_shown_and_not_obeyed(run: Trajectory):
    spoilt = Trajectory(**{**vars(run), "provenance": {"note": "<script>alert(1)</script>"}})
    text = htmlreport.page(spoilt)
    assert "<script>" not in text
    assert "<script>alert(1)</script>" in Page(text).sections["Provenance"]


def test_command_line(run: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run.save(tmp_path / "run.nc")
    assert main(["report", str(tmp_path / "run.nc")]) == 0
    assert Page((tmp_path / "run.html").read_text(encoding="utf-8")).pictures
    assert main(["report", str(tmp_path / "run.nc"), "-o", str(tmp_path / "other.html")]) == 0
    assert (tmp_path / "other.html").exists()
    capsys.readouterr()
    for arguments, key in (
        ([str(tmp_path / "none.nc")], "there is no such file"),
        ([str(tmp_path / "run.nc"), "-o", str(tmp_path / "page.txt")], "must end in .html or .htm"),
        ([str(tmp_path / "run.nc"), "-o", str(tmp_path / "no" / "page.html")], "there is no folder"),
    ):
        assert main(["report", *arguments]) == 2
        said = capsys.readouterr().err.splitlines()
        assert len(said) == 1
        assert key in said[0]
