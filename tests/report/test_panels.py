"""Pictures of a page: lines, axes and sentences agree with numbers from the run."""

import base64
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from matplotlib.figure import Figure

from lmpchain import Chain, Displacement, Force, Impulse, InputError, Scene, Trajectory, simulate
from lmpchain.measure import spectrum
from lmpchain.measure.contact import LINES
from lmpchain.report import panels
from lmpchain.report.live import crop, extent
from lmpchain.report.verdicts import front_below
from lmpchain.util.plotting import COLOURS, si

MARGIN = 4  # Number of resting grains that a picture shows beside the moving ones.
PREFIXES = {"": 1.0, "m": 1e-3, "µ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15, "k": 1e3, "M": 1e6}


class Drawn(NamedTuple):
    """A picture before it is written: its axes, its caption, and whether it is a map."""

    axes: list[Any]
    caption: str
    map: bool


@pytest.fixture
def draw(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Trajectory], Drawn]:
    """Return a function that draws a panel and stores its axes, without writing a file."""
    axes: list[Any] = []

    def keep(figure: Figure, *_: Any, **options: Any) -> None:
        axes[:] = figure.axes

    def drawn(name: str, run: Trajectory) -> Drawn:
        panel = getattr(panels, name)(run)
        return Drawn(list(axes), panel.caption, panel.map)

    monkeypatch.setattr(Figure, "savefig", keep)
    return drawn


def strike(grains: int, velocity: float, duration: float, samples: int, **chain: Any) -> Scene:
    column = Chain(**{"grains": grains, "diameter": 1e-3} | chain)
    struck = Impulse(velocity=velocity)
    return Scene(chain=column, excitation=struck, duration=duration, samples=samples)


@pytest.fixture(scope="module")
def hard() -> Trajectory:
    """Return a strike that opens contacts of a short column."""
    return simulate(strike(8, 0.3, 60e-6, 601), "native", 1e-9)


@pytest.fixture(scope="module")
def vacuum() -> Trajectory:
    """Return a solitary wave without gravity and load."""
    scene = strike(24, 0.1, 120e-6, 241, gravity=0.0, bottom="wall")
    return simulate(scene, "native", 1e-8)


def reached(wave: Trajectory) -> tuple[int, int]:
    """Return the first and the last grain that a picture shows."""
    largest = np.abs(wave.velocity).max(0)
    there = wave.grains[largest > 1e-3 * largest.max()]
    return max(there.min() - MARGIN, 1), min(there.max() + MARGIN, wave.grains.max())


def amount(text: str) -> float:
    """Return the number that a text with an SI prefix contains."""
    number, prefix = re.fullmatch(r"([\d.]+) (\D?)(?:m/s|s|Hz|N|J)", text).groups()
    return float(number) * PREFIXES[prefix]


def curve(ax: Any, place: int) -> np.ndarray:
    return np.array(ax.lines[place].get_xydata())


def force(wave: Trajectory) -> np.ndarray:
    """Return the forces of all contacts above rest, (T, N-1) N, by Hertz's law."""
    chain = wave.scene.chain
    overlap = chain.equilibrium_overlap - np.diff(wave.displacement)
    at_rest = chain.equilibrium_overlap**1.5
    return chain.contact_constants * (np.maximum(overlap, 0.0) ** 1.5 - at_rest)


# --- the picture as a file


def test_a_picture_is_an_svg_of_its_size_without_a_date(wave: Trajectory):
    panel = panels.balance(wave)
    assert panel.alt == panel.caption
    assert panels.balance(wave) == panel
    text = base64.b64decode(panel.svg).decode()
    width, height = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text).groups()
    assert (float(width), float(height)) == pytest.approx((4.7 * 72, 3.5 * 72))
    assert "<dc:date>" not in text
    assert "Matplotlib" not in text
    (background,) = re.findall(r'id="patch_1">\s*<path[^>]*style="([^"]*)"', text)
    assert "opacity: 0" in background or "fill: none" in background


def test_many_points_become_pixels(draw: Any, wave: Trajectory, monkeypatch: Any):
    """The pictures are sharp at 200 dots per inch."""
    shown = np.flatnonzero(np.any(wave.displacement != 0, 0)).size
    size = min(shown + MARGIN, 40)
    for limit, pixels in ((size, False), (size - 1, True)):
        monkeypatch.setattr(panels, "PANEL_LIMITS", panels.PANEL_LIMITS._replace(markers=limit))
        axes = draw("waveforms", wave).axes
        assert axes[0].lines[0].get_rasterized() == pixels
        assert not axes[0].lines[1].get_rasterized()


# --- the wave


def test_the_wave_is_shown_at_its_position(draw: Any, wave: Trajectory):
    picture = draw("wave", wave)
    first, last = reached(wave)
    assert 10 < last < 40
    assert picture.axes[0].get_ylim() == (last + 0.5, first - 0.5)
    text = f"Velocity of grains {first} to {last} over time: downward red, upward blue."
    assert picture.caption == text
    assert picture.map


def test_waveforms_are_velocities_at_three_times(draw: Any, wave: Trajectory):
    picture = draw("waveforms", wave)
    above, apart = picture.axes
    linear = simulate(wave.scene, "chebyshev").velocity
    largest = np.abs(wave.velocity).max()
    difference = (wave.velocity - linear) / largest
    shades = set()
    for place, (row, time) in enumerate(((30, "15 µs"), (60, "30 µs"), (120, "60 µs"))):
        grain, velocity = curve(above, 2 * place).T
        columns = grain.astype(int) - 1
        assert np.array_equal(velocity, wave.velocity[row, columns])
        assert above.lines[2 * place].get_label() == time
        assert above.lines[2 * place].get_linestyle() == "None"
        theory = curve(above, 2 * place + 1)
        assert np.array_equal(theory[:, 0], grain)
        assert theory[:, 1] == pytest.approx(linear[row, columns], rel=1e-9, abs=1e-12 * largest)
        below = curve(apart, place)
        assert np.array_equal(below[:, 0], grain)
        assert below[:, 1] == pytest.approx(difference[row, columns], rel=1e-9, abs=1e-12)
        same = {line.get_color() for line in above.lines[2 * place : 2 * place + 2]}
        assert same == {apart.lines[place].get_color()}
        points, line = above.lines[2 * place : 2 * place + 2]
        assert (points.get_markersize(), line.get_linewidth()) == (4, 1)
        shades |= same
    assert len(shades) == 3
    first, last = reached(wave)
    assert above.get_xlim() == (first - 0.5, last + 0.5)
    assert apart.get_xlim() == above.get_xlim()
    assert above.get_ylabel() == "velocity downward"
    assert above.yaxis.get_major_formatter()(2e-6) == "2 µm/s"
    assert apart.get_xlabel() == "grain, from the top"
    assert apart.get_ylabel() == "difference\n/ largest"
    assert curve(apart, 3)[:, 1].tolist() == [0.0, 0.0]
    labels = [text.get_text() for text in above.get_legend().get_texts()]
    assert labels == ["15 µs", "30 µs", "60 µs"]
    peak = np.abs(wave.velocity[-1])
    place = f"grain {peak.argmax() + 1}, {si(peak.max(), 'm/s', 1)}"
    head = f"At the end the motion is largest at {place}. "
    assert picture.caption.startswith(head)
    assert amount(si(peak.max(), "m/s", 1)) == pytest.approx(peak.max(), rel=2e-3)
    off = float(re.search(r"at most (\S+) of the largest velocity away", picture.caption)[1])
    assert off == pytest.approx(np.abs(difference).max(), rel=0.05)
    assert not picture.map
    assert [ax.get_title(loc="left") for ax in picture.axes] == ["(a)", "(b)"]
    assert above.figure.get_size_inches().tolist() == [4.7, 4.4]
    heights = [ax.get_gridspec().get_height_ratios() for ax in (above, apart)]
    assert heights == [(3, 1)] * 2, "the difference takes a quarter"


def test_waveforms_without_linear_theory_say_so(draw: Any, vacuum: Trajectory):
    picture = draw("waveforms", vacuum)
    # Axes without a curve are removed.
    (above,) = picture.axes
    assert len(above.lines) == 3
    assert above.get_xlabel() == "grain, from the top"
    assert above.xaxis.get_tick_params()["labelbottom"]
    assert picture.caption.endswith("There is no linear theory of this scene.")


# --- the front


def travel(chain: Chain, source: int) -> np.ndarray:
    """Return arrival times of a long weak wave at the grains below, s: sqrt(m / k) per contact."""
    stiffness = 1.5 * chain.contact_constants * np.sqrt(chain.equilibrium_overlap)
    mass = (chain.masses[:-1] + chain.masses[1:]) / 2
    passed = np.append(0.0, np.cumsum(np.sqrt(mass / stiffness)))
    return passed - passed[source - 1]


def test_the_front_is_drawn_against_depth_and_time(draw: Any, wave: Trajectory):
    picture = draw("arrival", wave)
    height, time = picture.axes
    depth, peak = curve(height, 0).T
    grains = (depth + 0.5).astype(int)
    largest = np.abs(wave.velocity).max(0)
    assert grains.tolist() == list(range(2, grains[-1] + 1))
    assert len(grains) > 10
    assert depth.tolist() == (grains - 0.5).tolist()
    assert peak == pytest.approx(largest[grains - 1], rel=5e-3)
    at_depth, law = curve(height, 1).T
    assert np.array_equal(at_depth, depth)
    assert law == pytest.approx(peak[-1] * (depth / depth[-1]) ** (-4 / 15), rel=1e-12)
    labels = [text.get_text() for text in height.get_legend().get_texts()]
    words = "this run weak wave deep in the column: power −0.267"
    assert " ".join(labels).split() == words.split()
    assert (height.get_xscale(), height.get_yscale()) == ("log", "log")
    assert height.get_xlabel() == "depth h = n − 1/2 (grains)"
    assert height.get_ylabel() == "peak velocity"
    assert height.yaxis.get_major_formatter()(2e-6) == "2 µm/s"
    assert height.xaxis.get_major_formatter()(0.5) == "0.5"
    assert height.yaxis.get_major_formatter()(2e-4) == "200 µm/s"
    for axis in (height.xaxis, height.yaxis):
        ticks = axis.get_major_locator().tick_values(1.0, 99.0)
        assert {1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 30.0, 50.0} <= set(np.round(ticks, 9))
        assert axis.get_minor_formatter()(2.0) == ""

    grain, arrival = curve(time, 0).T
    assert grain.tolist() == grains.tolist()
    later = [np.abs(wave.velocity[:, n - 1]).argmax() for n in grains]
    assert arrival == pytest.approx(1e6 * wave.time[later], abs=0.6)  # Samples are 0.5 µs apart.
    there, expected = curve(time, 1).T
    assert there.tolist() == grains.tolist()
    assert np.diff(expected) == pytest.approx(
        1e6 * np.diff(travel(wave.scene.chain, 1)[grains - 1]), rel=0.02
    )
    # Half a contact is added.
    assert expected[0] == pytest.approx(1e6 * travel(wave.scene.chain, 1)[1], rel=0.6)
    assert time.get_xlabel() == "grain, from the top"
    assert time.get_ylabel() == "arrival (µs)"
    said = [text.get_text() for text in time.get_legend().get_texts()]
    assert said == ["this run", "long weak wave"]
    pattern = (
        r"The front passes (\d+) grains; "
        r"its peak goes from (.+) at grain (\d+) to (.+) at grain (\d+)\. "
        r"Dashed: weak wave deep in the column\."
    )
    count, first, top, last, bottom = re.fullmatch(pattern, picture.caption).groups()
    assert (int(count), int(top), int(bottom)) == (len(grains), grains[0], grains[-1])
    assert amount(first) == pytest.approx(peak[0], rel=1e-3)
    assert amount(last) == pytest.approx(peak[-1], rel=1e-3)
    for ax in (height, time):
        assert ax.lines[0].get_markersize() == 4
        assert (ax.lines[1].get_linestyle(), ax.lines[1].get_linewidth()) == ("--", 1)
    assert [ax.get_title(loc="left") for ax in picture.axes] == ["(a)", "(b)"]
    assert height.figure.get_size_inches().tolist() == [4.7, 4.8]


def test_a_front_in_the_vacuum_has_a_constant_peak_and_no_weak_wave(draw: Any, vacuum: Trajectory):
    picture = draw("arrival", vacuum)
    height, time = picture.axes
    depth, law = curve(height, 1).T
    assert (law == law[-1]).all()
    assert height.lines[1].get_label().endswith("sonic vacuum: constant")
    assert len(time.lines) == 1
    assert picture.caption.endswith("Dashed: solitary wave of the sonic vacuum.")
    # The last three grains reflect the wave.
    assert depth[-1] == vacuum.scene.chain.grains - 3 - 0.5


def test_a_front_through_unequal_grains_has_no_law(draw: Any):
    diameter = np.linspace(1e-3, 1.02e-3, 40)
    unlike = simulate(strike(40, 1e-3, 60e-6, 121, diameter=diameter), "native")
    picture = draw("arrival", unlike)
    assert len(picture.axes[0].lines) == 1
    assert picture.caption.endswith("No law is known for this chain.")


@pytest.fixture
def law(draw: Any, wave: Trajectory) -> Callable[[Scene], tuple[float, str] | None]:
    """Return a function that gives the power of the drawn law of a scene, and its name."""

    def drawn(scene: Scene) -> tuple[float, str] | None:
        picture = draw("arrival", replace(wave, scene=scene))
        name = re.search(r"(?<=Dashed: ).*(?=\.$)", picture.caption)
        if name is None:
            assert picture.caption.endswith("No law is known for this chain.")
            return None
        depth, height = np.log(curve(picture.axes[0], 1)[[0, -1]]).T
        return (height[0] - height[1]) / (depth[1] - depth[0]), name[0]

    return drawn


def test_the_law_of_decay_depends_on_the_chain(law: Any, wave: Trajectory):
    """The exponent is 1/3 for the front of Bessel's functions J_2n, and 4/15 under gravity."""
    column = wave.scene
    assert law(column) == (pytest.approx(4 / 15, rel=1e-12), "weak wave deep in the column")
    loaded = strike(40, 1e-3, 60e-6, 121, gravity=0.0, top_load=1e-4)
    assert law(loaded) == (pytest.approx(1 / 3, rel=1e-12), "weak wave far from the strike")
    assert law(strike(40, 1e-3, 60e-6, 121, top_load=1e-6)) is None
    assert law(strike(40, 1e-3, 60e-6, 121, top="wall")) is None
    assert law(column.replace(excitation=Impulse(velocity=1e-3, grain=3))) is None
    assert law(column.replace(excitation=Displacement(displacement=1e-9))) is None


@pytest.mark.parametrize("key", ["masses", "contact_constants"])
def test_grains_are_equal_to_nine_digits(key: str, law: Any, wave: Trajectory):
    for off, known in ((9e-10, True), (1.1e-9, False)):
        values = np.array(getattr(wave.scene.chain, key))
        values[2] *= 1 + off
        assert (law(strike(40, 1e-3, 60e-6, 121, **{key: values})) is not None) == known


def test_a_front_travels_downward(wave: Trajectory):
    """A front passes at least six grains, and nine of ten in order."""
    from lmpchain.measure import front

    sine = wave.scene.replace(excitation=Force(amplitude=1e-3, frequency=1e4))
    with pytest.raises(InputError, match="excitation: sends no single front"):
        front_below(replace(wave, scene=sine))
    whole = front.track(wave)
    below = whole.between(2, 37)
    assert np.array_equal(front_below(wave).time, below.time)

    def front_of(times: np.ndarray, error: float = 0.0, run: Trajectory = wave) -> front.Front:
        grains = np.arange(2, 2 + times.size)
        columns = [times, *[np.ones(times.size)] * 2, *[np.full(times.size, error)] * 3]
        with pytest.MonkeyPatch.context() as patch:
            passing = front.Front("velocity", grains, 1e-3 * grains, *columns)
            patch.setattr(front, "track", lambda run: passing)
            return front_below(run)

    onward = np.arange(21.0)
    for back, ok in ((2, True), (3, False)):  # Number of the twenty steps that go backward.
        times = onward.copy()
        times[2 : 2 + 2 * back : 2] -= 1.5
        assert (np.diff(times) < 0).sum() == back
        if ok:
            assert np.array_equal(front_of(times).time, times)
        else:
            with pytest.raises(InputError, match="none travels downward from grain 1 past 6"):
                front_of(times)
    assert front_of(np.arange(6.0)).time.size == 6
    with pytest.raises(InputError, match="or more"):
        front_of(np.arange(5.0))
    with pytest.raises(InputError, match="none travels"):
        front_of(np.zeros(8))
    # Unresolved grains are omitted; an error is raised if there are many.
    with pytest.raises(InputError, match="none travels"):
        front_of(np.arange(20.0), error=1e-6)
    coarse = replace(wave, scene=wave.scene.replace(samples=5))
    phase = wave.scene.highest_frequency * wave.scene.duration
    needed = 1 + int(np.ceil(phase / front.RESOLVED_TURN))
    with pytest.raises(InputError, match=f"^samples: 15 .s apart .* at least {needed} samples"):
        front_of(np.arange(20.0), 1e-3, coarse)
    # Closer samples do not help a front of few grains.
    with pytest.raises(InputError, match=r"^front: none travels"):
        front_of(np.arange(5.0), 1e-3, coarse)


# --- spectra, contacts, energy


def test_the_dispersion_is_that_of_the_moving_grains(draw: Any, wave: Trajectory):
    picture = draw("dispersion", wave)
    first, last = extent(crop(wave))
    assert picture.caption.startswith(f"Spectrum of grains {first} to {last} over wavenumber")
    result = spectrum.dispersion(wave, first, last)
    # For a wave exp(i q n - i w t), Newton's law is m w^2 = 4 k sin(q/2)^2, at most 4 k.
    chain = wave.scene.chain
    middle = result.grain[1]
    stiff = chain.linear_stiffness[middle - 2 : middle].mean()
    edge = np.sqrt(4 * stiff / chain.masses[0]) / (2 * np.pi)
    assert result.relation[1].max() == pytest.approx(edge, rel=1e-2)


def test_the_spectrum_states_its_maximum(draw: Any, wave: Trajectory, vacuum: Trajectory):
    picture = draw("spectra", wave)
    first, last = reached(wave)
    assert picture.axes[0].get_ylim() == (last + 0.5, first - 0.5)
    assert picture.map
    text = (
        r"Velocity spectrum of every grain, strongest at (.+)\. "
        r"The line is the local cut-off frequency\."
    )
    strongest = amount(re.fullmatch(text, picture.caption)[1])
    size = np.abs(np.fft.rfft(wave.velocity, axis=0))
    step = wave.time[1]
    frequency = np.fft.rfftfreq(wave.time.size, step)
    expected = frequency[np.unravel_index(size.argmax(), size.shape)[0]]
    assert strongest == pytest.approx(expected, abs=1 / wave.time[-1])
    empty = draw("spectra", vacuum).caption
    assert re.fullmatch(r"Velocity spectrum of every grain, strongest at \S+ \S*Hz\.", empty)


def test_contacts_state_their_largest_force_and_number_of_openings(
    draw: Any, wave: Trajectory, hard: Trajectory
):
    for t in (wave, hard):
        picture = draw("forces", t)
        change = np.abs(force(t)).max(0)
        pattern = (
            r"Force of every contact above that at rest, at most (.+), in contact (\d+)\. "
            r"(?:No contact opens|Contacts open (\d+) times?)\."
        )
        largest, contact, openings = re.fullmatch(pattern, picture.caption).groups()
        assert int(contact) == change.argmax() + 1
        assert amount(largest) == pytest.approx(change.max(), rel=5e-3)
        overlap = t.scene.chain.equilibrium_overlap - np.diff(t.displacement)
        opened = (np.diff((overlap > 0).astype(int), axis=0) < 0).sum()
        assert int(openings or 0) == opened
        assert picture.map
        first, last = reached(t)
        assert picture.axes[0].get_ylim() == (last + 0.5, first - 0.5)
    assert opened > 1


def test_a_few_contacts_are_lines(draw: Any, hard: Trajectory):
    columns = slice(1, LINES + 1)  # The lowest grain is fixed, so that the contact below is known.
    grains = hard.grains[columns]
    u = hard.displacement[:, columns]
    v = hard.velocity[:, columns]
    scene = hard.scene.replace(grains=grains.tolist())
    few = replace(hard, scene=scene, grains=grains, displacement=u, velocity=v)
    picture = draw("forces", few)
    assert not picture.map
    change = force(hard)[:, columns]
    low, high = picture.axes[0].get_ylim()
    assert low < change.min() < change.max() < high
    for place, line in enumerate(picture.axes[0].lines[:LINES]):
        values = np.interp(hard.time, *line.get_xydata().T)
        assert values == pytest.approx(change[:, place], rel=1e-6, abs=1e-9 * high)


def test_one_opening_is_one_time(draw: Any, hard: Trajectory):
    overlap = hard.scene.chain.equilibrium_overlap - np.diff(hard.displacement)
    opened = np.diff((overlap > 0).astype(int), axis=0) < 0
    first = int(np.flatnonzero(opened.any(1))[0]) + 2
    rows = slice(0, first)
    scene = hard.scene.replace(duration=float(hard.time[first - 1]), samples=first)
    u = hard.displacement[rows]
    v = hard.velocity[rows]
    short = replace(hard, scene=scene, time=hard.time[rows], displacement=u, velocity=v)
    assert draw("forces", short).caption.endswith("Contacts open 1 time.")


def test_the_energy_is_that_of_the_strike_with_little_drift(draw: Any, wave: Trajectory):
    picture = draw("balance", wave)
    pattern = (
        r"Energy relative to rest\. "
        r"Drift: change not explained by work done on the chain, at most (\S+) of the "
        r"largest energy, (.+)\."
    )
    drift, largest = re.fullmatch(pattern, picture.caption).groups()
    given = wave.scene.chain.masses[0] * 1e-3**2 / 2
    assert amount(largest) == pytest.approx(given, rel=1e-3)
    assert float(drift) < 1e-8
    assert not picture.map
    worse = replace(wave, velocity=wave.velocity * np.linspace(1.0, 1.5, wave.time.size)[:, None])
    said = re.fullmatch(pattern, draw("balance", worse).caption)
    kinetic = 0.5 * (wave.scene.chain.masses[:-1] * wave.velocity[:, :-1] ** 2).sum(1)
    more = kinetic * (np.linspace(1.0, 1.5, wave.time.size) ** 2 - 1)
    assert float(said[1]) == pytest.approx(more.max() / (given + more).max(), rel=0.05)
    assert amount(said[2]) == pytest.approx((given + more).max(), rel=0.05)


def test_lines_are_distinguished_from_zero(draw: Any, wave: Trajectory):
    assert draw("waveforms", wave).axes[1].lines[3].get_color() == COLOURS["vermilion"]
