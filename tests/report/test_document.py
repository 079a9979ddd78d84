"""Text and numbers of a page: title, cards, facts, live view, and origin of the run."""

import json
import os
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.live_figure import arrays
from helpers.seals import seal_anew

from lmpchain import Chain, Drive, Impulse, Profile, Scene, Trajectory, simulate
from lmpchain.measure.front import Front
from lmpchain.report import document, page, write
from lmpchain.report.document import title
from lmpchain.report.live import VIEW, View, crop, extent, figure_numbers, view
from lmpchain.report.verdicts import facts
from lmpchain.trajectory.record import ErrorEstimate


def shown(run: Trajectory) -> View:
    """Return the part of a run that the live figure of a page shows."""
    return view(run, extent(crop(run))).thinned(VIEW.times, VIEW.grains)


def figure(run: Trajectory) -> dict[str, Any]:
    """Return the data that the script of the live figure reads from a page."""
    return arrays(figure_numbers([shown(run)]))


CHAIN = Chain(grains=40, diameter=1e-3)
STRIKE = Impulse(velocity=1e-3)


@pytest.fixture(scope="module")
def priced(wave: Trajectory) -> Trajectory:
    """Return the run with chosen errors and costs."""
    cost = wave.cost._replace(integration_s=1.25, estimate_s=0.5, setup_s=0.125, compile_s=9.0)
    cost = cost._replace(steps=1234, force_evaluations=5678, active_grains=37, ranks=3, step_s=2e-8)
    return replace(wave, error_estimate=ErrorEstimate(3e-3, 2e-5), cost=cost)


def cards_of(text: str) -> dict[str, list[str]]:
    """Return the value and the remark of each card of a page, by name."""
    cards = re.findall(r"<dt>(.*?)</dt>(.*?)</div>", text)
    cells = {name: re.findall(r"<dd[^>]*>(.*?)</dd>", rest) for name, rest in cards}
    return {unescape(name): [*map(unescape, each)] for name, each in cells.items()}


def facts_of(text: str) -> dict[str, str]:
    """Return the rows of two cells of the tables of a page."""
    rows = re.findall(r'<tr><th scope="row">(.*?)</th><td>(.*?)</td></tr>', text)
    return {unescape(key): unescape(value) for key, value in rows}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that gives the page of a run without its pictures."""
    monkeypatch.setattr(document, "PANELS", {})
    origin = {"date": "yesterday", "command": "lmpchain run"}
    return lambda run: page(run, origin=origin)


def test_cards_show_request_and_cost(priced: Trajectory, quick: Any):
    cards = cards_of(quick(priced))
    assert list(cards) == ["Scene", "Engine", "Tolerance", "Error", "Cost", "Date", "Command"]
    name, remark = cards["Scene"]
    assert name == f"40 grains, {STRIKE.label}"
    said = r"Strike number (\S+); linear theory is off by (\S+) % of the largest velocity\."
    number, off = map(float, re.fullmatch(said, remark).groups())
    assert number == pytest.approx(priced.scene.strike_number, rel=5e-3)
    linear = simulate(priced.scene, "modes")
    error = np.abs(priced.velocity - linear.velocity).max() / np.abs(priced.velocity).max()
    assert off == pytest.approx(100 * error, rel=0.05)
    assert cards["Engine"] == ["native", f"solves Eq. (1) {priced.cost.integrator}"]
    assert cards["Tolerance"] == ["1e-09", "largest relative error asked for"]
    assert cards["Error"] == ["0.003", "estimated: 0.003 (equation) + 2e-05 (solver)"]
    assert cards["Cost"] == ["1.88 s", "1234 steps of 2e-08 s, 37 grains computed"]
    assert cards["Date"] == ["yesterday"]
    assert cards["Command"] == ["lmpchain run"]


def test_facts_agree_with_the_run(priced: Trajectory, quick: Any):
    facts = facts_of(quick(priced))
    assert facts["chain"] == "40 grains, top free, bottom fixed, exponent 1.5"
    assert facts["gravity and load"] == "9.81 m/s², 0 N"
    assert facts["excitation"] == "impulse: velocity 0.001 m/s"
    assert facts["recorded"] == "40 grains at 121 times up to 6e-05 s"
    fastest, farthest = (np.abs(x).max() for x in (priced.velocity, priced.displacement))
    assert facts["largest velocity"] == f"{fastest:.6g} m/s"
    assert facts["largest displacement"] == f"{farthest:.6g} m"
    cost = {
        "integration (s)": "1.25", "estimate (s)": "0.5", "setup (s)": "0.125", "steps": "1234",
        "force evaluations": "5678", "active grains": "37", "step (s)": "2e-08", "ranks": "3",
        "compile (s)": "9",
    }  # fmt: skip
    assert cost.items() <= facts.items()
    profile = Profile(velocity=[1e-3, *[0.0] * 39])
    other = replace(priced, scene=priced.scene.replace(excitation=profile))
    assert facts_of(quick(other))["excitation"] == "profile: velocity of 40 values"


def test_a_title_names_chain_excitation_duration_and_engine(priced: Trajectory, quick: Any):
    label = STRIKE.label
    assert title(priced) == f"40 grains, g = 9.81 m/s², {label}, 60 µs, native"
    for grain, load in ((1, "load 2 N"), (2, "load 2 N on grain 2")):
        loaded = CHAIN.replace(gravity=0.0, top_load=2.0, load_grain=grain)
        other = replace(priced, scene=priced.scene.replace(chain=loaded, duration=1e-3))
        assert title(other) == f"40 grains, no gravity, {load}, {label}, 1 ms, native"
    damped = priced.scene.replace(chain=CHAIN.replace(damping={"drag": 100.0}))
    cards = cards_of(quick(replace(priced, scene=damped)))
    assert cards["Without damping"] == [f"{damped.damping_effect:.2g}", damped.damping_remark]


def test_the_progress_bar_counts_every_part(priced: Trajectory, monkeypatch: pytest.MonkeyPatch):
    steps: list[Any] = []

    class Bar:
        def __init__(self, total: float, text: str, unit: str, *, shown: bool):
            steps.append((total, text, unit, shown))

        def __enter__(self) -> "Bar":
            return self

        def __exit__(self, *_: object) -> None:
            steps.append("over")

        def describe(self, text: str) -> None:
            steps.append(text)

        def advance(self) -> None:
            steps.append(1)

    empty = {
        name: (lambda t, name=name: document.Panel(name, name, "")) for name in document.PANELS
    }
    monkeypatch.setattr(document, "PANELS", empty)
    monkeypatch.setattr(document, "ProgressBar", Bar)
    page(priced, progress=True)
    names = ["The wave in space and time", *empty, "Fits"]
    expected = [each for name in names for each in (name, 1)]
    assert steps == [(len(names), "report", " parts", True), *expected, "over"]
    steps.clear()
    page(priced)
    assert not steps[0][3]


def test_a_page_is_written_atomically(
    priced: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(document, "PANELS", {})
    write(priced, tmp_path / "page.html", origin={"date": "yesterday", "command": "é"})
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text == page(priced, origin={"date": "yesterday", "command": "é"})
    assert os.listdir(tmp_path) == ["page.html"]


# --- the live view


def moved(first: int, last: int, samples: int = 11, grains: int = 400) -> Trajectory:
    """Return a run in which only these grains move."""
    chain = Chain(grains=grains, diameter=1e-3)
    scene = Scene(chain=chain, excitation=STRIKE, duration=1e-4, samples=samples)
    velocity = np.zeros((samples, grains))
    rng = np.random.default_rng(first)
    velocity[1:, first - 1 : last] = rng.uniform(-1e-3, 1e-3, (samples - 1, last - first + 1))
    few = Scene(chain=CHAIN, excitation=STRIKE, duration=1e-6, samples=2)
    fields = {"time": scene.time, "grains": scene.recorded, "displacement": velocity * 1e-6}
    return replace(simulate(few, "native", 1e-3), scene=scene, velocity=velocity, **fields)


def test_grains_at_rest_are_omitted_except_four_on_either_side():
    for first, last, shown in ((20, 30, (16, 34)), (3, 5, (1, 9)), (390, 399, (386, 400))):
        t = moved(first, last)
        part = crop(t)
        assert (part.grains[0], part.grains[-1]) == shown
        assert extent(t) == extent(part) == shown
        columns = slice(shown[0] - 1, shown[1])
        assert np.array_equal(part.velocity, t.velocity[:, columns])
        assert np.array_equal(part.displacement, t.displacement[:, columns])
        assert part.scene.recorded.tolist() == part.grains.tolist()
        assert figure(t)["grains"].tolist() == list(range(shown[0], shown[1] + 1))
    still = replace(moved(3, 5), velocity=np.zeros((11, 400)), displacement=np.zeros((11, 400)))
    assert crop(still) is still
    assert extent(still) == (1, 400)
    data = figure(still)
    assert not data["velocity"].any()
    assert not data["displacement"].any()


def test_slow_grains_are_omitted_from_the_range():
    """Grains slower than a thousandth of the fastest one are left out."""
    t = moved(20, 30)
    velocity = np.array(t.velocity)
    largest = np.abs(velocity).max()
    velocity[5, 39] = 1.01e-3 * largest
    velocity[5, 49] = 0.99e-3 * largest
    slow = replace(t, velocity=velocity)
    assert extent(slow) == (16, 44)
    assert crop(slow).grains[-1] == 54
    assert figure(slow)["grains"].tolist() == list(range(16, 45))


@pytest.mark.parametrize("order", ["as they stand", "turned round"])
def test_the_live_view_stores_velocities_in_16_bits(order: str):
    t = moved(20, 60, samples=31)
    if order == "turned round":
        grains = t.grains[::-1]
        scene = t.scene.replace(grains=grains.tolist())
        fields = {"velocity": t.velocity[:, ::-1], "displacement": t.displacement[:, ::-1]}
        t = replace(t, scene=scene, grains=grains, **fields)
    data = figure(t)
    columns = [int(np.flatnonzero(t.grains == n)[0]) for n in data["grains"]]
    velocity = t.velocity[:, columns]
    largest = np.abs(velocity).max()
    assert data["time"] == pytest.approx(t.time, rel=1e-8)
    assert data["grains"].tolist() == list(range(16, 65))
    assert data["unit"] == largest / 32767
    assert np.abs(data["velocity"]).max() == pytest.approx(largest)
    assert data["velocity"] == pytest.approx(velocity, abs=largest / 32767 / 1.99)
    displacement = t.displacement[:, columns]
    assert data["displacement"] == pytest.approx(
        displacement, abs=np.abs(displacement).max() / 32767 / 1.99
    )
    assert data["rest"] == pytest.approx(
        t.scene.chain.equilibrium_overlap[15:63], abs=t.scene.chain.equilibrium_overlap.max() / 6e4
    )
    peaks = np.abs(velocity).max(0)
    assert data["limit"] == pytest.approx(np.median(peaks[peaks > 0]), rel=1e-5)


def test_the_live_view_selects_times_and_grains():
    t = moved(1, 400, samples=701)
    data = figure(t)
    assert data["time"].size == 240
    rows = np.searchsorted(t.time, data["time"] * (1 - 1e-8))
    assert rows[0] == 0
    assert rows[-1] == 700
    assert set(np.diff(rows)) == {2, 3}
    # At most 160 of 400 grains are shown, which is every third.
    assert data["grains"].tolist() == list(range(1, 401, 3))
    velocity = t.velocity[rows]
    group = velocity[:, 3:6]
    loudest = np.abs(group - group[:1]).max(0).argmax()
    assert data["velocity"][:, 1] == pytest.approx(group[:, loudest], abs=0.51 * data["unit"])
    # Beads are these grains, and overlaps are sums over all contacts between them.
    u = t.displacement[np.ix_(rows, range(0, 400, 3))]
    assert data["displacement"] == pytest.approx(u, abs=np.abs(u).max() / 6e4)
    overlap = t.scene.chain.equilibrium_overlap[:399].reshape(133, 3).sum(1)
    assert data["rest"] == pytest.approx(overlap, abs=overlap.max() / 6e4)
    assert len(data["law"]) == 134
    assert figure(moved(1, 160, samples=240))["time"].size == 240
    assert figure(moved(5, 156, samples=5))["grains"].size == 160
    assert figure(moved(5, 157, samples=5))["grains"].size == 81


def test_nan_is_shown_as_rest_in_the_live_view():
    t = moved(20, 30)
    velocity = np.array(t.velocity)
    velocity[4, 24] = np.nan
    data = figure(replace(t, velocity=velocity))
    assert data["velocity"][4, data["grains"].tolist().index(25)] == 0


def test_equal_arrays_are_stored_once():
    """Linear theory of one chain is equal for all strikes, apart from its unit."""
    plain = shown(moved(20, 30))
    loud = replace(plain, velocity=3 * plain.velocity)
    one, three = figure_numbers([plain, loud])["runs"]
    assert one["velocity"][0] == three["velocity"][0]
    assert 3 * one["velocity"][1] == pytest.approx(three["velocity"][1])


def test_the_live_view_draws_the_arrival_of_a_weak_wave(priced: Trajectory):
    """The time is sqrt(m / k) per contact from the struck grain, if weak waves travel."""

    def arrival(scene: Scene) -> Any:
        return view(replace(priced, scene=scene), (1, 40)).law

    chain = priced.scene.chain
    stiffness = 1.5 * chain.contact_constants * np.sqrt(chain.equilibrium_overlap)
    slow = np.sqrt(chain.masses[0] / stiffness)
    third = arrival(priced.scene.replace(excitation=Impulse(velocity=1e-3, grain=3)))
    assert len(third) == 40
    assert third[2] == 0.0
    assert third[9] == pytest.approx(slow[2:9].sum(), rel=1e-9)
    assert third[0] == pytest.approx(slow[:2].sum(), rel=1e-9)
    first = arrival(priced.scene)
    assert np.diff(first)[1:] == pytest.approx(slow[1:], rel=1e-9)
    walled = chain.replace(top="wall")
    drive = Drive(amplitude=1e-9, frequency=1e4, grain=0)
    wall = priced.scene.replace(chain=walled, excitation=drive)
    assert np.diff(arrival(wall))[1:].shape == (38,)
    assert arrival(wall)[0] == 0.0
    profile = priced.scene.replace(excitation=Profile(velocity=[1e-3, *[0.0] * 39]))
    assert arrival(profile) is None
    empty = priced.scene.replace(chain=chain.replace(gravity=0.0, bottom="free"))
    assert arrival(empty) is None


# --- origin of a run


def test_a_folder_states_the_start_of_its_first_session(tmp_path: Path):
    sessions = [
        {"began": "2024-05-06T23:08:09+02:00", "command": "lmpchain run s.toml"},
        {"began": "2024-05-07T00:00:00+00:00", "command": "lmpchain resume"},
    ]
    (tmp_path / "run.json").write_text(json.dumps({"sessions": sessions}))
    expected = {"date": "2024-05-06 21:08 UTC", "command": "lmpchain run s.toml"}
    assert document.origin(tmp_path) == expected
    os.utime(tmp_path, (1.7e9, 1.7e9))
    by_file = {"date": "2023-11-14 22:13 UTC (file)", "command": "not recorded"}
    odd = '{"sessions": [{"began": "today", "command": ""}]}'
    for text in ("{}", '{"sessions": []}', odd, "["):
        (tmp_path / "run.json").write_text(text)
        assert document.origin(tmp_path) == by_file


def test_records_of_sessions_are_read_up_to_16_MB(tmp_path: Path):
    session = json.dumps({"sessions": [{"began": "2024-05-06T00:00:00+00:00", "command": "run"}]})
    for size, command in ((2**24, "run"), (2**24 + 1, "not recorded")):
        (tmp_path / "run.json").write_text(session.ljust(size))
        assert document.origin(tmp_path)["command"] == command


def test_a_file_states_its_origin_in_the_history(tmp_path: Path):
    path = tmp_path / "run.nc"
    with h5py.File(path, "w") as file:
        file.attrs["history"] = "2024-05-06T07:08:09+00:00 lmpchain run s.toml -o run.nc"
    unsealed = path.read_bytes()
    seal_anew(path)
    expected = {"date": "2024-05-06 07:08 UTC", "command": "lmpchain run s.toml -o run.nc"}
    assert document.origin(path) == expected
    by_file = {"date": "2023-11-14 22:13 UTC (file)", "command": "not recorded"}
    for content in (unsealed, b"no such file"):
        path.write_bytes(content)
        os.utime(path, (1.7e9, 1.7e9))
        assert document.origin(str(path)) == by_file
    unknown = {"date": "not recorded", "command": "not recorded"}
    assert document.origin(None) == document.origin(tmp_path / "none") == unknown


@pytest.mark.parametrize("order", [1, -1])
def test_contacts_open_if_grains_separate_by_more_than_their_overlap(order: int):
    """The grains above a contact rise by a multiple of its overlap, which differs from others."""

    def contacts(run: Trajectory) -> str:
        return dict(facts(run, None, "", 1e-6))["contacts"]

    chain = Chain(grains=6, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=1e-6, samples=4)
    still = simulate(scene)
    # Grain 4 is not recorded, so that the contacts 1, 2 and 5 are known.
    grains = np.array([1, 2, 3, 5, 6])[::order]
    assert np.diff(chain.equilibrium_overlap).min() > 0.1 * chain.equilibrium_overlap[0]
    for contact in (1, 2, 5):
        for rise, verdict in ((1.01, "1 of 3 open"), (0.99, "none opens")):
            motion = np.zeros((4, 5))
            motion[1:3] = -rise * chain.equilibrium_overlap[contact - 1] * (grains <= contact)
            run = replace(still, grains=grains, displacement=motion)
            assert contacts(run) == verdict
    apart = replace(still, grains=grains[::2], displacement=still.displacement[:, ::2])
    assert contacts(apart) == "none between two recorded grains"


GRAINS = np.arange(2, 21)
DEPTH = 1e-3 * GRAINS
# The front is slow down to grain 10.
FRONT = GRAINS, DEPTH, np.cumsum(np.where(GRAINS < 11, 9e-6, 4e-6)), *np.ones((5, 19))


def test_the_error_of_linear_theory_is_stated(wave: Trajectory):
    for off, words in (
        (0.9e-5, "holds to better than 0.001 %"),
        (1.1e-5, "holds to 0.0011 %"),
        (0.049, "holds to 4.9 %"),
        (0.051, "is off by 5.1 %"),
        (1.4, "is off by 140 %"),
    ):
        linear = replace(wave, velocity=(1 + off) * wave.velocity)
        stated = dict(facts(wave, linear, Front("velocity", *FRONT), 1e-9))
        assert stated["linear theory"] == f"{words} of the largest velocity"
        assert stated["strike number"] == f"{wave.scene.strike_number:.3g}"
        # The speed is that of the last ten grains, 250 m/s, not of the first.
        assert stated["front"] == "reaches grain 20, at 250 m/s"
        assert stated["largest velocity"] == "1.0 mm/s"
        assert "above the tolerance" not in stated["estimated error"]
    error = wave.error_estimate.total
    missed = dict(facts(wave, None, "none", error / 2))
    assert f"above the tolerance {error / 2:.2g}".replace("e-0", "e-") in missed["estimated error"]
    assert (missed["linear theory"], missed["front"]) == ("none of this scene", "none")
    assert "damping" not in missed
    damped = wave.scene.chain.replace(damping={"drag": 1.0})
    dragged = replace(wave, scene=wave.scene.replace(chain=damped))
    assert dict(facts(dragged, None, "none", 1.0))["damping"] == dragged.scene.damping_remark
