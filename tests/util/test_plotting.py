"""Charts: numbers with units, sizes in inches, letters and lines that fit, distinct colours."""

import struct
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colors, pyplot, rcParams
from matplotlib.text import Text

from lmpchain import engines
from lmpchain.util import plotting
from lmpchain.util.plotting import (
    COLOURS,
    SHADES,
    SHAPES,
    axes_in_units,
    chart,
    colour_bar,
    draw_map,
    edges,
    figure,
    finish,
    label_ends,
    legend,
    look_of,
    mark_decades,
    panels,
    save,
    set_title,
    si,
    thin_rows,
    window,
)

NARROW, PANEL, WIDE = 3.2, 4.7, 6.4  # Inches: half a page, a picture of a report, a window.


def axes(width: float, height: float = 3.0):
    return axes_in_units(figure(width, height).subplots(), "s", "m")


# --- numbers


@pytest.mark.parametrize(
    ("rows", "most"), [(6, 2), (7, 3), (100, 7), (9, 9), (8, 9), (1, 1), (5, 4)]
)
def test_a_map_with_fewer_rows_keeps_the_largest_deviations(rows: int, most: int):
    rng = np.random.default_rng(rows)
    values = rng.normal(size=(rows, 4))
    numbers = np.arange(1.0, rows + 1)
    few = int(np.ceil(rows / most))
    kept, drawn = thin_rows(numbers, values, most)
    assert len(kept) <= most
    assert kept.tolist() == numbers[::few].tolist()
    for place, row in enumerate(drawn):
        group = values[place * few : (place + 1) * few]
        change = [np.abs(each - each[0]).max() for each in group]
        assert np.array_equal(row, group[np.argmax(change)])


def test_a_map_has_2000_rows_at_most_by_default():
    for rows in (2000, 2001, 3999):
        kept, drawn = thin_rows(np.arange(float(rows)), np.zeros((rows, 2)))
        assert len(kept) == len(drawn) == (2000 if rows == 2000 else (rows + 1) // 2)


def test_edges_are_halfway_between_centres():
    assert edges(np.array([3.0])).tolist() == [2.5, 3.5]
    centres = np.array([1.0, 2.0, 5.0, 5.5])
    inner = [(a + b) / 2 for a, b in pairwise(centres)]
    assert edges(centres).tolist() == [0.5, *inner, 5.75]


def test_numbers_with_their_prefix():
    assert si(1.5e-6, "s") == "1.5 µs"
    assert si(6e4, "Hz", 1) == "60.0 kHz"
    assert si(2.346e-3, "m/s", 2) == "2.35 mm/s"
    assert si(0.0, "N") == "0 N"


# --- figures


def test_figures_have_the_requested_size():
    assert figure().get_size_inches().tolist() == [8.0, 7.0]
    assert figure(3.0, 2.0).get_size_inches().tolist() == [3.0, 2.0]
    assert pyplot.get_fignums() == []
    shown = window()
    assert shown.get_size_inches().tolist() == [6.4, 4.2]
    assert window(3.0, 2.0).get_size_inches().tolist() == [3.0, 2.0]
    assert shown.number in pyplot.get_fignums()
    ax = axes_in_units(None, "s", "m")
    assert ax.figure.get_size_inches().tolist() == [6.4, 4.2]
    assert ax.figure.number in pyplot.get_fignums()


def test_a_picture_is_saved_with_the_requested_resolution(tmp_path: Path):
    picture = figure(4.0, 2.0)
    for what, dpi in ((picture, 150), (picture.subplots(), 150), (picture, 50)):
        path = tmp_path / "picture.png"
        save(what, path) if dpi == 150 else save(what, path, dpi)
        width, height = struct.unpack(">II", path.read_bytes()[16:24])
        assert (width, height) == (4 * dpi, 2 * dpi)
    assert [one.name for one in tmp_path.iterdir()] == ["picture.png"]


# --- axes


def test_ticks_have_units_with_prefixes():
    ax = axes_in_units(figure(WIDE, 3.0).subplots(), "s", "m/s")
    assert ax.xaxis.get_major_formatter()(2.5e-5) == "25 µs"
    assert ax.yaxis.get_major_formatter()(1e-3) == "1 mm/s"
    plain = axes_in_units(figure(WIDE, 3.0).subplots(), "", "")
    ticks = [plain.xaxis.get_major_formatter(), plain.yaxis.get_major_formatter()]
    assert [tick.format_ticks([2500.0]) for tick in ticks] == [["2500"], ["2500"]]


@pytest.mark.parametrize(
    ("span", "ticks", "label"),
    [
        ((0.0, 5e-4), ["0", "100", "200", "300", "400", "500"], "energy (µJ)"),
        ((-2e-3, 2e-3), ["−2", "−1", "0", "1", "2"], "energy (mJ)"),
        ((0.0, 1000.0), ["0", "0.5", "1"], "energy (kJ)"),
        ((0.0, 2.0), ["0", "1", "2"], "energy (J)"),
    ],
)
def test_units_are_in_the_label_and_plain_numbers_at_the_ticks(
    span: tuple[float, float], ticks: list[str], label: str
):
    ax = axes_in_units(figure(WIDE, 3.0).subplots(), "", "J")
    # The unit of an earlier drawing is replaced.
    ax.set(ylabel="energy (nJ)", ylim=span, yticks=np.linspace(*span, len(ticks)))
    for _ in range(2):
        assert [tick.get_text() for tick in ax.get_yticklabels()] == ticks
        assert ax.get_ylabel() == label
    ax.set_ylabel("")
    assert ax.get_yticklabels()[-1].get_text().endswith("J")


def test_a_logarithmic_axis_uses_the_unit_of_its_middle():
    ax = figure(WIDE, 3.0).subplots()
    ax.set(xscale="log", xlabel="cost", xlim=(0.9e-4, 1.1), xticks=[1e-4, 1e-2, 1.0])
    axes_in_units(ax, "s", "")
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["0.1", "10", "1000"]
    assert ax.get_xlabel() == "cost (ms)"


@pytest.mark.parametrize("width", [NARROW, WIDE])
def test_a_logarithmic_axis_keeps_its_unit(width: float):
    ax = axes_in_units(figure(width, 3.0).subplots(), "s", "m/s", "y")
    ax.plot([0.0, 1e-3], [2e-6, 3e-2])
    ax.set(ylabel="velocity", ylim=(1e-6, 1e-1), yticks=[1e-5, 1e-3])
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "log")
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["10", "1000"]
    assert ax.get_ylabel() == "velocity (µm/s)"
    # Minor ticks have no numbers, because these would lack the prefix.
    assert not any(tick.get_text() for tick in ax.get_yticklabels(minor=True))
    near = axes_in_units(figure(width, 3.0).subplots(), "s", "m/s", "y")
    near.set(ylim=(2e-6, 9e-6))
    minor = near.get_yticklabels(minor=True)
    assert (len(minor) > 3, any(tick.get_text() for tick in minor)) == (True, False)
    both = axes_in_units(figure(width, 3.0).subplots(), "s", "", "xy")
    assert (both.get_xscale(), both.get_yscale()) == ("log", "log")


def most_intervals(ax, which: str) -> int:
    """Return the largest number of intervals that ticks make along an axis."""
    most = 0
    for longest in range(1, 25):
        getattr(ax, f"set_{which}lim")(0, longest)
        ticks = getattr(ax, f"get_{which}ticks")()
        most = max(most, int(((ticks >= 0) & (ticks <= longest)).sum()) - 1)
    return most


def test_ticks_leave_room_for_their_labels():
    """Labels on a time axis have about an inch each."""
    assert most_intervals(axes(WIDE), "x") == 6
    assert most_intervals(axes(WIDE), "y") > 6
    assert most_intervals(axes(NARROW), "x") == most_intervals(axes(NARROW), "y") == 5
    logarithmic = figure(WIDE, 3.0).subplots()
    logarithmic.set_xscale("log")
    axes_in_units(logarithmic, "s", "m")
    assert logarithmic.get_xscale() == "log"
    free = axes_in_units(figure(WIDE, 3.0).subplots(), "", "m")
    assert most_intervals(free, "x") > 6


def letters(ax) -> set[float]:
    """Return the sizes of the letters of ticks and labels, in points."""
    ticks = [
        tick.label1.get_fontsize()
        for axis in (ax.xaxis, ax.yaxis)
        for tick in axis.get_major_ticks()
    ]
    return {*ticks, ax.xaxis.label.get_fontsize(), ax.yaxis.label.get_fontsize()}


def test_letters_are_smaller_on_narrow_axes_and_equal():
    size = rcParams["font.size"]
    assert letters(axes(WIDE)) == letters(axes(PANEL)) == {size}
    (small,) = letters(axes(NARROW))
    assert size * 0.75 < small < size
    for width, expected in ((NARROW, small), (PANEL, size)):
        ax = axes(width)
        assert letters(ax) == {expected}
        shown = ax.imshow(np.eye(2), aspect="auto")
        colour_bar(ax, shown, "velocity (m/s)", ticks=[0.0, 1.0])
        bar = ax.figure.axes[-1]
        assert bar.get_ylabel() == "velocity (m/s)"
        assert bar.yaxis.label.get_fontsize() == expected
        assert {tick.label2.get_fontsize() for tick in bar.yaxis.get_major_ticks()} == {expected}
        assert bar.get_yticks().tolist() == [0.0, 1.0]


def test_lines_use_the_palette_unless_lines_exist():
    ax = axes(WIDE)
    for _ in COLOURS:
        ax.plot([0, 1], [0, 1])
    assert [line.get_color() for line in ax.lines] == list(COLOURS.values())
    axes_in_units(ax, "s", "m")
    (line,) = ax.plot([0, 1], [1, 0])
    assert line.get_color() == next(iter(COLOURS.values()))
    (begun,) = figure(WIDE, 3.0).subplots().plot([0, 1], [0, 1])
    other = begun.axes
    axes_in_units(other, "s", "m")
    (second,) = other.plot([0, 1], [0, 1])
    assert second.get_color() not in COLOURS.values()


def test_engines_and_integrators_differ_in_colour_and_marker():
    looks = [engines.class_of(name).style for name in engines.names()]
    colours, markers = zip(*looks, strict=True)
    assert set(colours) == set(COLOURS.values())
    assert len(set(markers)) == len(looks)
    assert len(SHADES) == len(SHAPES) == len(set(SHAPES))
    shades = [look_of(name) for name in (*plotting.INTEGRATORS, "another")]
    assert shades == [
        {"color": c, "marker": m} for c, m in zip(SHADES, SHAPES, strict=True)
    ]  # fmt: skip
    for palette in (list(COLOURS.values()), list(SHADES)):
        for one, other in combinations(palette, 2):
            distance = np.subtract(colors.to_rgb(one), colors.to_rgb(other))
            assert np.linalg.norm(distance) > 0.15


def test_one_or_several_axes_are_accepted():
    both = figure(8.0, 3.0).subplots(1, 2)
    assert panels(both) == panels(list(both)) == list(both)
    assert panels(both[0]) == [both[0]]


# --- text


WORDS = "energy of the grains and of the contacts between them relative to that at rest " * 2


def drawn_width(text) -> float:
    """Return the drawn width of a text in inches."""
    picture = text.figure.figure
    picture.draw_without_rendering()
    return text.get_window_extent().width / picture.dpi


@pytest.mark.parametrize("width", [2.0, NARROW, PANEL, WIDE, 10.0])
def test_titles_are_as_wide_as_their_axes(width: float):
    """The limit is close, because a letter is about half as wide as high."""
    ax = axes(width)
    set_title(ax, WORDS)
    (title,) = (text for text in ax.findobj(Text) if text.get_text() == ax.get_title("left"))
    assert title.get_fontsize() == rcParams["font.size"]
    inches = ax.get_position().width * width
    room = int(inches * 72 / (0.52 * title.get_fontsize()))
    lines = title.get_text().splitlines()
    assert " ".join(lines) == WORDS.strip()
    assert max(map(len, lines)) <= room
    firsts = [line.split()[0] for line in lines[1:]]
    assert all(len(a) + 1 + len(b) > room for a, b in zip(lines, firsts, strict=False))
    assert drawn_width(title) < 1.05 * inches


def test_the_narrowest_axes_fit_a_word():
    ax = axes(0.8)
    set_title(ax, "displacement downward")
    assert ax.get_title("left") == "displacement\ndownward"


@pytest.mark.parametrize("width", [NARROW, PANEL, WIDE])
def test_a_legend_fits_its_axes(width: float):
    ax = axes(width)
    assert ax.get_legend() is None
    legend(ax)
    assert ax.get_legend() is None
    ax.plot([0, 1], [0, 1], label=WORDS)
    ax.plot([0, 1], [1, 0], label="short")
    legend(ax)
    shown = ax.get_legend()
    long, short = shown.get_texts()
    assert short.get_text() == "short"
    assert " ".join(long.get_text().split()) == WORDS.strip()
    inches = ax.get_position().width * width
    # Letters with their line and gap, which take two points of each letter.
    size = long.get_fontsize()
    room = int(inches * 72 / (0.52 * (size + 2)))
    lines = long.get_text().splitlines()
    assert max(map(len, lines)) <= room
    firsts = [line.split()[0] for line in lines[1:]]
    assert all(len(a) + 1 + len(b) > room for a, b in zip(lines, firsts, strict=False))
    ax.figure.draw_without_rendering()
    assert shown.get_window_extent().width / ax.figure.dpi < 1.05 * inches
    smallest = min(letters(ax))
    assert 0.8 * smallest < size <= smallest
    assert not shown.get_frame_on()


def assert_lower_left(ax) -> None:
    """Assert that the legend is at the lower left corner, at most a letter away from each axis."""
    ax.figure.draw_without_rendering()
    away = ax.get_legend().get_window_extent().min - ax.get_window_extent().min
    assert ((away > 0) & (away < rcParams["font.size"] / 72 * ax.figure.dpi)).all()


def test_a_legend_of_given_handles():
    ax = axes(WIDE)
    lines = [ax.plot([0, 1], [0, 1])[0] for _ in range(2)]
    legend(ax, lines, ["one", "two"], loc="lower left", frameon=True)
    shown = ax.get_legend()
    assert [text.get_text() for text in shown.get_texts()] == ["one", "two"]
    assert shown.get_frame_on()
    assert_lower_left(ax)
    (first, _) = shown.get_lines()
    size = shown.get_texts()[0].get_fontsize()
    assert np.ptp(first.get_xdata()) == pytest.approx(1.5 * size)  # Shorter than in matplotlib.
    legend(ax, lines, ["one", "two"], below=0.2)
    ax.figure.draw_without_rendering()
    box, frame = ax.get_legend().get_window_extent(), ax.get_window_extent()
    assert (box.x0 + box.x1) / 2 == pytest.approx((frame.x0 + frame.x1) / 2, abs=1.0)
    assert 0 <= frame.y0 - 0.2 * frame.height - box.y1 < 0.05 * frame.height


def test_zero_is_drawn_below_all_rounding_errors():
    assert 0 < plotting.LEAST_ERROR < 1e-16


def test_names_at_the_ends_of_curves_do_not_overlap():
    ax = figure(WIDE, 3.0).subplots()
    ax.margins(y=0)
    ax.semilogy([0.0, 1.0], [1.0, 100.0])
    label_ends(ax, [(10.0, "b", "blue"), (60.0, "d", "red"), (10.0, "c", "green"), (2.0, "a", "k")])
    assert [text.get_text() for text in ax.texts] == ["a", "b", "c", "d"]
    middle = 0.5 + plotting.LABEL_HEIGHT
    shares = [np.log10(2.0) / 2, 0.5, middle, np.log10(60.0) / 2]
    for text, share, height in zip(ax.texts, shares, (2.0, 10.0, 10.0, 60.0), strict=True):
        assert text.xyann == pytest.approx((1.02, share), rel=1e-12)
        assert text.xy == (1.0, height)
        assert text.xycoords == ("axes fraction", "data")
    assert [text.get_color() for text in ax.texts] == ["k", "blue", "green", "red"]


def test_charts_have_a_title_a_legend_and_plain_numbers_at_decades():
    ax = chart(figure(WIDE, 3.0).subplots(), "number", "share", "x")
    ax.plot([1.0, 100.0], [0.0, 1.0], label="kept")
    mark_decades(ax)
    assert finish(ax, "A title", loc="lower left") is ax
    assert ax.get_title("left") == "A title"
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["kept"]
    assert_lower_left(ax)
    ticks = [tick for tick in ax.get_xticks() if 1 <= tick <= 100]
    assert ticks == pytest.approx([1, 2, 5, 10, 20, 50, 100], rel=1e-12)
    formatter = ax.xaxis.get_major_formatter()
    assert [formatter(tick) for tick in ticks] == ["1", "2", "5", "10", "20", "50", "100"]
    assert not any(label.get_text() for label in ax.get_xticklabels(minor=True))
    assert not finish(chart(None, "a", "b")).get_title("left")


def test_cells_of_a_map_surround_their_centres():
    ax = figure(WIDE, 3.0).subplots()
    values = np.arange(6.0).reshape(2, 3)
    draw_map(ax, np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0]), values, "force [N]", vmax=9.0)
    (mesh,) = ax.images
    assert mesh.get_extent() == pytest.approx([-0.5, 2.5, 0.0, 4.0], rel=1e-12)
    assert np.array_equal(mesh.get_array(), values)
    assert mesh.get_clim() == (0.0, 9.0)
    assert ax.figure.axes[1].get_ylabel() == "force"


def test_several_panels_have_letters():
    first, second = (axes(WIDE) for _ in range(2))
    second.set_title("Errors", loc="left")
    plotting.letter_panels([first, second])
    assert [ax.get_title(loc="left") for ax in (first, second)] == ["(a)", "(b) Errors"]
    alone = axes(WIDE)
    plotting.letter_panels([alone])
    assert not alone.get_title(loc="left")
