"""Display of a chain: remarks, table and picture."""

import re
import warnings

import numpy as np
import pytest
from matplotlib.figure import Figure

from lmpchain import PTFE, Chain
from lmpchain.chain.picture import DETAILED_GRAINS, DRAWN_POINTS


def remarks(**fields: object) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Chain(**{"grains": 4, "diameter": 1e-3, "gravity": 0.0} | fields)  # type: ignore[arg-type]
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize("alike", [True, False])
def test_grains_of_metres_cause_a_remark(alike: bool) -> None:
    for width, count in ((0.3, 0), (0.31, 1)):
        texts = remarks(diameter=width if alike else [1e-3, width, 1e-3, 1e-3])
        assert len(texts) == count
    assert texts == ["diameter: 0.31 m is wide for a grain; diameters are in metres (1 mm is 1e-3)"]


@pytest.mark.parametrize("alike", [True, False])
def test_a_load_beyond_hertz_causes_a_remark(alike: bool) -> None:
    most = 2 / 3 * 62e9 / 0.96 * np.sqrt(0.25e-3) * 1e-5**1.5
    width = {} if alike else {"diameter": [1e-3] * 4}
    assert not remarks(top_load=0.999 * most, **width)
    said = (
        "diameter: at rest a contact is compressed by 0.02 of the diameter; "
        "Hertz's law holds up to about 0.01"
    )
    assert remarks(top_load=2**1.5 * most, **width) == [said]
    assert not remarks(top_load=2**1.5 * most, exponent=1.6, **width)


def test_a_notebook_shows_the_units_of_a_chain() -> None:
    chain = Chain(grains=5, diameter=1e-3, material=["glass", "ptfe", "ptfe", "glass", "glass"])
    cells = re.findall(r"<td[^>]*>(.*?)</td>", chain._repr_html_())
    rows = {cells[n]: cells[n + 1 : n + 3] for n in range(0, len(cells) - 2, 3)}
    glass = 2426 * np.pi / 6 * 1e-9
    ptfe = PTFE.density * np.pi / 6 * 1e-9
    soft = 0.96 / 62e9 + (1 - 0.46**2) / 1.46e9
    constant = 4 / 3 / soft * np.sqrt(0.25e-3)
    overlap = (9.81 * glass / constant) ** (2 / 3)
    time = np.sqrt(glass / (1.5 * constant * np.sqrt(overlap)))
    assert rows["unit of length"] == [f"{overlap:.6g} m", "overlap of the first contact at rest"]
    assert rows["unit of time"] == [f"{time:.6g} s", "unit of the paper&#x27;s tau"]
    assert rows["mass"] == [f"{3 * glass + 2 * ptfe:.6g} kg", "of all grains"]
    assert "data:image/png" in chain._repr_html_()
    long = Chain(grains=DETAILED_GRAINS + 1, diameter=1e-3, gravity=1e-3)
    assert "unit of length" not in long._repr_html_()
    assert "data:image/png" not in long._repr_html_()


def test_the_picture_shows_relative_masses_and_overlaps() -> None:
    chain = Chain(grains=5, diameter=[1e-3, 2e-3, 1e-3, 1e-3, 3e-3])
    axes = chain.plot(Figure().subplots())
    masses, overlaps = axes.get_lines()
    assert masses.get_xdata().tolist() == [1, 2, 3, 4, 5]
    assert masses.get_ydata() == pytest.approx(chain.masses / chain.masses[-1], rel=1e-14)
    assert overlaps.get_xdata().tolist() == [1.5, 2.5, 3.5, 4.5]
    assert overlaps.get_ydata() == pytest.approx(
        chain.equilibrium_overlap / chain.equilibrium_overlap.max(), rel=1e-14
    )
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    milligrams = 1e6 * chain.masses[-1]
    nanometres = 1e9 * chain.equilibrium_overlap.max()
    assert labels == [f"mass / {milligrams:.3g} mg", f"overlap at rest / {nanometres:.3g} nm"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("grain, from the top", "over the largest")
    assert axes.get_ylim()[0] == 0
    assert axes.get_ylim()[1] > 1.1
    vacuum = Chain(grains=5, diameter=1e-3, gravity=0.0).plot(Figure().subplots())
    assert len(vacuum.get_lines()) == 1
    many = Chain(grains=2 * DRAWN_POINTS + 1, diameter=1e-3).plot(Figure().subplots())
    assert many.get_lines()[0].get_xdata()[:3].tolist() == [1, 4, 7]
