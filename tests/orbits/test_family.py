"""The picture and the table of a family of orbits: curves, positions and units."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.independent_theory import dense_modes

from lmpchain import Chain, Drive, Force
from lmpchain.errors import InputError
from lmpchain.orbits.family import Event, Family
from lmpchain.util.plotting import COLOURS

LOADED = {"diameter": 1e-2, "gravity": 0.0, "top_load": 20.0}
DIMER = Chain(grains=8, masses=np.resize([3e-3, 1e-3], 8), **LOADED)
# The values have the rounding of 1 / period.
FREQUENCY = 1 / (1 / np.array([2000.0, 1900.0, 1800.0, 1850.0, 1700.0]))
ENERGY = np.array([1e-6, 2e-6, 4e-6, 6e-6, 8e-6])
SHAKER = Drive(amplitude=1e-9, frequency=1e3)
PUSH = Force(amplitude=1e-3, frequency=1e3, grain=2)
STABLE = np.array([True, True, False, False, True])


def family(
    chain: Chain, ended: str = "", events: tuple[Event, ...] = (), scale: float = 1.0
) -> Family:
    """Return a family with given numbers."""
    orbits = [
        SimpleNamespace(
            chain=chain,
            drive=None,
            period=1 / (scale * f),
            energy=e,
            stable=bool(s),
            multipliers=np.array([f + 1j, 1 / f]),
            to_json=lambda f=f: {"frequency": f},
        )
        for f, e, s in zip(FREQUENCY, ENERGY, STABLE, strict=True)
    ]
    sequence: tuple[Any, ...] = tuple(orbits)
    return Family(sequence, 3 * ENERGY, "energy", events, not ended, ended)


def event(kind: str, place: int) -> Event:
    orbit: Any = SimpleNamespace(period=1 / FREQUENCY[place], energy=ENERGY[place], drive=None)
    return Event(kind, 3 * ENERGY[place], orbit)


def bands(ax: Any) -> np.ndarray:
    """Return the lower and upper edges of shaded bands, (B, 2)."""
    return np.array([[patch.get_x(), patch.get_x() + patch.get_width()] for patch in ax.patches])


def test_a_family_is_an_array_of_its_orbits():
    whole = family(DIMER)
    np.testing.assert_array_equal(whole.period, 1 / FREQUENCY)
    np.testing.assert_array_equal(whole.energy, ENERGY)
    np.testing.assert_array_equal(whole.stable, STABLE)
    np.testing.assert_array_equal(whole.multipliers, np.stack((FREQUENCY + 1j, 1 / FREQUENCY), 1))
    assert (len(whole), whole[1].period) == (5, 1 / 1900.0)


def test_a_picture_has_energies_over_frequencies_the_unstable_part_dashed():
    kinds = ("fold", 1), ("period doubling", 2), ("branch point", 3), ("fold", 4)
    events = tuple(event(kind, place) for kind, place in kinds)
    ax = family(DIMER, "it stops here", events).plot()
    lines = {line.get_label(): line for line in ax.lines}
    assert list(lines) == ["stable", "unstable", "fold", "period doubling", "branch point"]
    assert [line.get_linestyle() for line in ax.lines] == ["-", "--", "None", "None", "None"]
    assert [line.get_marker() for line in ax.lines] == [".", ".", "o", "s", "D"]
    for line in (lines["stable"], lines["unstable"]):
        np.testing.assert_array_equal(line.get_xdata(), FREQUENCY)
        assert line.get_color() == COLOURS["blue"]
    np.testing.assert_array_equal(lines["stable"].get_ydata(), np.where(STABLE, ENERGY, np.nan))
    # The dashed line begins at the last stable orbit before it.
    dashed = np.array([False, True, True, True, False])
    np.testing.assert_array_equal(lines["unstable"].get_ydata(), np.where(dashed, ENERGY, np.nan))
    np.testing.assert_array_equal(
        lines["fold"].get_xydata(), np.stack((FREQUENCY, ENERGY), 1)[[1, 4]]
    )
    np.testing.assert_array_equal(lines["branch point"].get_xydata(), [[FREQUENCY[3], ENERGY[3]]])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("frequency", "energy above rest")
    assert ax.get_yscale() == "log"
    assert ax.get_title("left") == "It stops here"
    assert ax.xaxis.get_major_formatter()(2000.0) == "2 kHz"
    assert ax.yaxis.get_major_formatter()(2e-6).endswith("J")
    places = ax.yaxis.get_majorticklocs()
    low, high = ax.get_ylim()
    # Matplotlib 3.10 has additional ticks outside the drawn range.
    ticks = np.round(1e6 * places[(places >= low) & (places <= high)], 9)
    assert {1.0, 2.0, 5.0} <= set(ticks) <= {0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0}
    assert ax.yaxis.get_minor_formatter()(2e-6) == ""
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["linear waves", *lines]  # A single entry represents two bands.
    assert len(ax.patches) == 2
    assert ax.get_legend().get_frame_on()
    assert ax.get_legend().get_frame().get_alpha() == 1.0


def test_a_family_that_is_stable_throughout_has_one_line_and_no_title():
    whole = family(DIMER)
    for orbit in whole.orbits:
        orbit.stable = True
    ax = whole.plot()
    assert [line.get_label() for line in ax.lines] == ["stable"]
    assert ax.get_title("left") == ""


def test_bands_of_a_dimer_have_the_exact_edges():
    """The bands are w^2 = 0 to 2K/M and 2K/m to 2K (1/m + 1/M)."""
    k = DIMER.linear_stiffness[0]
    light = 1e-3
    heavy = 3e-3
    squares = [[0, 2 * k / heavy], [2 * k / light, 2 * k * (1 / light + 1 / heavy)]]
    edges = bands(family(DIMER).plot())
    np.testing.assert_allclose(edges, np.sqrt(squares) / (2 * np.pi), rtol=1e-12, atol=1e-9)


def test_the_band_of_a_uniform_chain_ends_at_twice_its_root_of_stiffness_over_mass():
    chain = Chain(grains=8, masses=np.full(8, 1e-3), **LOADED)
    edges = bands(family(chain).plot())
    exact = 2 * np.sqrt(chain.linear_stiffness[0] / 1e-3) / (2 * np.pi)
    np.testing.assert_allclose(edges, [[0, exact]], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("kind", ["weights", "one grain heavier", "one contact stiffer"])
def test_the_range_of_modes_is_drawn_for_a_chain_without_repetition(kind: str):
    """The modes are eigenvalues of the matrix of masses and springs."""
    chain = Chain(grains=5, masses=np.full(5, 1e-3), **LOADED)
    if kind == "weights":
        chain = Chain(grains=5, diameter=1e-3)
    elif kind == "one grain heavier":
        chain = chain.replace(masses=[1e-3, 1e-3, 1e-3, 2e-3, 1e-3])
    else:
        chain = chain.replace(contact_constants=chain.contact_constants * [1, 1, 2, 1])
    frequency = np.sqrt(dense_modes(chain)[0]) / (2 * np.pi)
    edges = bands(family(chain).plot())
    np.testing.assert_allclose(edges, [[frequency[0], frequency[-1]]], rtol=1e-10)


def test_an_uncompressed_chain_has_no_bands():
    chain = Chain(grains=5, diameter=1e-3, gravity=0.0, top="wall", bottom="wall")
    assert not family(chain).plot().patches


def test_edges_of_bands_are_shown_near_the_family():
    """A band edge within 10 % of the family is shown, with a margin of 8 % on either side."""
    edge = 2 * np.sqrt(DIMER.linear_stiffness[0] / (2 * 3e-3)) / (2 * np.pi)
    for ratio, inside in ((1.11, True), (1.112, False)):
        scale = ratio * edge / FREQUENCY.min()
        frequency = scale * FREQUENCY
        low = edge if inside else frequency.min()
        margin = 0.08 * (frequency.max() - low)
        limits = family(DIMER, scale=scale).plot().get_xlim()
        assert limits == pytest.approx((low - margin, frequency.max() + margin), rel=1e-12)
    for ratio, inside in ((0.91, True), (0.908, False)):
        scale = ratio * edge / FREQUENCY.max()
        frequency = scale * FREQUENCY
        high = edge if inside else frequency.max()
        margin = 0.08 * (high - frequency.min())
        limits = family(DIMER, scale=scale).plot().get_xlim()
        assert limits == pytest.approx((frequency.min() - margin, high + margin), rel=1e-12)


def test_a_family_of_one_frequency_has_room_beside_it():
    whole = family(Chain(grains=5, diameter=1e-3, gravity=0.0, top="wall", bottom="wall"))
    for orbit in whole.orbits:
        orbit.period = 1e-3
    assert whole.plot().get_xlim() == pytest.approx((999, 1001), rel=1e-12)


def test_the_numbers_of_a_family_are_written_with_its_last_orbit():
    json = family(DIMER, events=(event("fold", 2),)).to_json()
    assert json == {
        "parameter": "energy",
        "value": (3 * ENERGY).tolist(),
        "period_s": (1 / FREQUENCY).tolist(),
        "energy_J": ENERGY.tolist(),
        "stable": STABLE.tolist(),
        "events": [
            {
                "kind": "fold",
                "value": 3 * ENERGY[2],
                "period_s": 1 / FREQUENCY[2],
                "energy_J": ENERGY[2],
            }
        ],
        "orbit": {"frequency": FREQUENCY[-1]},
    }


def driven(parameter: str, drive: Drive | Force, low: float) -> Family:
    """Return a family of driven orbits whose responses begin at `low` and end at 100."""
    orbits = [
        SimpleNamespace(
            chain=DIMER.replace(damping={"drag": 10.0}),
            drive=drive.replace(frequency=f),
            period=2 / f,
            energy=e,
            stable=True,
            response=lambda of, size=size: size * (2 if of == "force:3" else 1),
        )
        for f, e, size in zip(FREQUENCY, ENERGY, np.geomspace(low, 100.0, 5), strict=True)
    ]
    sequence: tuple[Any, ...] = tuple(orbits)
    return Family(sequence, 3 * ENERGY, parameter, (), True)


@pytest.mark.parametrize(
    ("parameter", "drive", "unit", "label"),
    [
        ("drive.frequency", SHAKER, "Hz", "frequency of the drive"),
        ("drive.amplitude", SHAKER, "m", "amplitude of the drive"),
        ("amplitude", PUSH, "N", "amplitude"),
        ("damping.drag[2]", PUSH, "1/s", "damping.drag[2]"),
        ("damping.viscoelastic", PUSH, "s", "damping.viscoelastic"),
        ("chain.top_load", SHAKER, "N", "chain.top_load"),
        ("gravity", SHAKER, "m/s²", "gravity"),
        ("masses[7]", SHAKER, "kg", "masses[7]"),
        ("diameter[1]", SHAKER, "m", "diameter[1]"),
        ("exponent", SHAKER, "", "exponent"),
    ],
)
def test_a_response_is_drawn_over_the_parameter_in_its_unit(
    parameter: str, drive: Drive | Force, unit: str, label: str
):
    header = f"{parameter} [{unit}]" if unit else parameter
    by_frequency = parameter == "drive.frequency"
    sizes = np.geomspace(1.9, 100.0, 5)
    whole = driven(parameter, drive, 1.9)
    frame = whole.to_dataframe()
    columns = {header: 3 * ENERGY, "period [s]": 2 / FREQUENCY, "energy [J]": ENERGY}
    columns |= {"amplitude [m]": sizes, "stable": np.full(5, True)}
    assert list(frame.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(frame[name], values)
    ax = whole.plot()
    (line,) = ax.lines
    np.testing.assert_array_equal(line.get_xdata(), FREQUENCY if by_frequency else 3 * ENERGY)
    np.testing.assert_array_equal(line.get_ydata(), sizes)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (label, "largest displacement")
    # A resonance curve over a wide range has a logarithmic axis.
    assert ax.get_yscale() == ("log" if by_frequency else "linear")
    assert ax.yaxis.get_major_formatter()(2.0) == "2 m"
    assert not unit or ax.xaxis.get_major_formatter()(2.0) == f"2 {unit}"
    # Bands are those of the chain without damping, and have frequencies.
    assert len(ax.patches) == (2 if by_frequency else 0)


def test_a_narrow_resonance_curve_of_a_force_has_a_linear_axis():
    whole = driven("period", SHAKER, 2.1)
    for of, name, unit in (
        ("force:3", "force of contact 3, half of its range", "N"),
        ("displacement:3", "displacement of grain 3, half of its range", "m"),
    ):
        ax = whole.plot(of=of)
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("frequency of the drive", name)
        assert (ax.get_yscale(), ax.get_ylim()[0]) == ("linear", 0.0)
        assert ax.yaxis.get_major_formatter()(2.0) == f"2 {unit}"
        np.testing.assert_array_equal(ax.lines[0].get_xdata(), FREQUENCY)
        factor = 2 if of == "force:3" else 1
        np.testing.assert_array_equal(ax.lines[0].get_ydata(), factor * np.geomspace(2.1, 100.0, 5))


def turned(places: tuple[int, ...], first: int, last: int) -> Family:
    """Return the orbits from first to last, with folds after some of them."""
    events = tuple(replace(event("fold", place), after=place - first) for place in places)
    whole = family(DIMER)
    return replace(
        whole,
        orbits=whole.orbits[first : last + 1],
        value=whole.value[first : last + 1],
        events=events,
    )


def test_joined_families_equal_the_uncut_family():
    events = tuple(replace(event("fold", place), after=place) for place in (1, 3))
    whole = family(DIMER, events=events)
    pieces = (turned((1,), 0, 2), turned((3,), 2, 4))
    upwards = pieces[0].join(pieces[1])
    downwards = pieces[1].backwards().join(pieces[0].backwards())
    for joined in (upwards, downwards.backwards()):
        np.testing.assert_array_equal(joined.value, whole.value)
        assert [e.after for e in joined.events] == [1, 3]
        assert [orbit.energy for orbit in joined] == ENERGY.tolist()
        drawn = joined.plot().lines
        for line, true in zip(drawn, whole.plot().lines, strict=True):
            np.testing.assert_array_equal(line.get_xydata(), true.get_xydata())
    # The events are between orbits 4 and 3, then 2 and 1, which are numbers 0 and 2 from above.
    assert [e.after for e in downwards.events] == [0, 2]


def test_a_joined_family_states_the_ending_of_its_first_unfinished_piece():
    lower = turned((), 0, 2)
    upper = replace(turned((), 2, 4), reached=False, ended="it turns back")
    joined = lower.join(upper)
    assert (joined.reached, joined.ended) == (False, "it turns back")
    # An event without a position remains without one.
    assert lower.join(replace(upper, events=(event("fold", 3),))).events[0].after == -1


def test_only_consecutive_families_are_joined():
    lower = turned((), 0, 1)
    with pytest.raises(
        InputError, match=r"begins at energy = 1.2e-05 .* ends at 6e-06: .*backwards"
    ):
        lower.join(turned((), 2, 4))
    with pytest.raises(InputError, match="must be energy for all joined families"):
        lower.join(replace(turned((), 1, 4), parameter="period"))
