"""Energy in bands of wavenumber is conserved; each packet has its place, band and direction."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.changed_recordings import part_of
from helpers.example_scenes import run

from lmpchain import Chain, Impulse, InputError, Packet, Trajectory
from lmpchain.measure import energy, wavenumbers

HOST = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0, "bottom": "wall"}


@cache
def packet(grains: int = 400, wavenumber: float = 1.0) -> Trajectory:
    """Simulate a packet of one wavenumber that travels down a uniform chain."""
    chain = Chain(grains=grains, top="wall", **HOST)
    frequency = np.sin(wavenumber / 2) / np.pi / chain.time_scale
    wave = Packet(frequency=frequency, width=14, grain=120, amplitude=1e-12)
    return run(chain, wave, 150 * chain.time_scale, 31, 1e-7)


@pytest.mark.parametrize("load", [0.0, 1.0])
@pytest.mark.parametrize("width", [8, 31, 48, 90])
def test_bands_add_up_to_the_energy_of_the_chain(
    rng: np.random.Generator, load: float, width: int
) -> None:
    """The sum is exact to 1e-12 at all times, also for strong waves in random chains with walls."""
    diameter = rng.normal(1e-3, 1e-4, 90)
    walls = {"top": "wall", "bottom": "wall", "gravity": 0.0}
    chain = Chain(grains=90, diameter=diameter, top_load=load, **walls)
    strike = Impulse(velocity=0.1, grain=20)
    t = run(chain, strike, 2e-4, 21, 1e-6)
    split = wavenumbers.bands(t, np.pi * np.array([0, 0.1, 0.25, 0.7, 1]), width)
    assert split.energy.min() >= 0
    assert split.total == pytest.approx(energy.ledger(t).total, rel=1e-12)
    near = energy.shares(t)
    of_all = near.kinetic.sum(1) + near.elastic.sum(1)
    assert split.total == pytest.approx(of_all, rel=1e-12)
    assert (split.downward <= split.energy * (1 + 1e-12)).all()
    # Each window is a cosine of half its width, and the outermost ones are flat up to the ends.
    count = max(1, round(180 / width) - 1)
    hop = 90 / (count + 1)
    assert split.place == pytest.approx(0.5 + hop * np.arange(1, count + 1), rel=1e-12)
    assert split.width == pytest.approx(2 * hop, rel=1e-12)
    assert split.resolution == pytest.approx(2 * np.pi / hop, rel=1e-12)
    for number, middle in enumerate(split.place):
        inside, square = np.zeros((2, len(t.time)))
        for places, values, errors in (
            (near.grain, near.kinetic, near.kinetic_error),
            (near.contact + 0.5, near.elastic, near.elastic_error),
        ):
            far = np.clip((places - middle) / hop, -1.0, 1.0)
            far = np.maximum(far, 0) if number == 0 else far
            far = np.minimum(far, 0) if number == count - 1 else far
            weight = np.cos(np.pi / 2 * far) ** 2
            inside += values @ weight
            ends = (np.sqrt(np.maximum(values + side * errors, 0.0)) for side in (-1, 1))
            square += np.max([(end - np.sqrt(values)) ** 2 for end in ends], axis=0) @ weight
        seen = split.energy[:, number].sum(1)
        assert seen == pytest.approx(inside, rel=1e-9, abs=1e-12 * inside.max())
        # The squares of the errors of all amplitudes in a window add up.
        error = 2 * np.sqrt(split.energy[:, number] * square[:, None]) + square[:, None]
        assert split.error[:, number] == pytest.approx(error, rel=1e-6)


def test_a_packet_is_in_its_band_and_moves_at_the_group_velocity() -> None:
    """Place, direction and band of a packet of one radian per grain agree with linear theory."""
    t = packet()
    split = wavenumbers.bands(t, [0, 0.6, 1.4, np.pi], 60)
    inside = split.energy[..., 1].sum(1) / split.total
    assert (inside > 1 - 1e-3).all()
    down = split.downward.sum((1, 2)) / split.total
    # Windows at the ends of the packet give a small upward share.
    assert (down > 1 - 1e-3).all()
    mirrored = wavenumbers.bands(replace(t, velocity=-t.velocity), [0, 0.6, 1.4, np.pi], 60)
    assert mirrored.energy == pytest.approx(split.energy, rel=1e-12)
    up = (mirrored.energy - mirrored.downward).sum((1, 2)) / split.total
    assert (up > 1 - 1e-3).all()
    centre = (split.energy.sum(2) @ split.place) / split.total
    speed = np.polyfit(split.time, centre, 1)[0] * t.scene.chain.time_scale
    # The packet has wavenumbers around 1 with a spread of 1/20, so the mean speed is exact to 2e-3.
    assert speed == pytest.approx(np.cos(0.5), rel=2e-3)


def test_table_and_picture_have_the_bands() -> None:
    """The table has a row for each time and place, and the picture a colour for each band."""
    split = wavenumbers.bands(packet(), [0, 1.5, np.pi], 80)
    table = split.to_dataframe()
    assert len(table) == split.time.size * split.place.size
    assert table["energy_0_to_1.5 [J]"].sum() == pytest.approx(split.energy[..., 0].sum())
    axes = split.plot()
    assert axes.get_legend_handles_labels()[1] == ["0 to 1.5", "1.5 to 3.1"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("grain, from the top", "energy per grain")
    # The areas add up to the energy per grain of all bands at the last sample.
    tops = [shape.get_paths()[0].vertices[:, 1].max() for shape in axes.collections]
    assert tops[-1] == pytest.approx(split.energy[-1].sum(1).max() / (split.width / 2), rel=1e-9)
    # The order of the recorded grains does not matter.
    t = packet()
    other = part_of(t, columns=np.argsort(np.sin(t.grains)))
    for name in ("energy", "downward", "error"):
        same = getattr(wavenumbers.bands(other, [0, 1.5, np.pi], 80), name)
        assert same == pytest.approx(getattr(split, name), rel=1e-9)


def test_energies_that_cannot_be_split_are_rejected() -> None:
    """Each mistake raises an error of one line with its key."""
    t = packet()
    for arguments, key in (
        (([0, 1],), "edges"),
        (([0, 2, 1, np.pi],), "edges"),
        (([0.1, np.pi],), "edges"),
        (([0],), "edges"),
        (([[0, np.pi]],), "edges"),
        ((None, 7), "width"),
        ((None, 401), "width"),
    ):
        with pytest.raises(InputError, match=f"^{key}"):
            wavenumbers.bands(t, *arguments)
