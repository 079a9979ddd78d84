"""Scripts of the design examples against transfer matrices, Bloch waves and long-wave speeds."""

import runpy
import sys
from pathlib import Path

import figures
import pytest
from matplotlib import rc_context

DESIGN = Path(figures.__file__).parent / "design"


@pytest.fixture
def numbers(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> dict[str, float]:
    """Run the script of this name and return the numbers that it prints."""
    path = str(DESIGN / f"{request.param}.py")
    picture = tmp_path / "picture.png"
    monkeypatch.setattr(sys, "argv", [path, "--quick", "-o", str(picture)])
    figures.PRINTED_NUMBERS.clear()
    with rc_context():
        runpy.run_path(path, run_name="__main__")
    assert picture.read_bytes()[:4] == b"\x89PNG"
    return dict(figures.PRINTED_NUMBERS)


@pytest.mark.slow
@pytest.mark.parametrize("numbers", ["delay_line"], indirect=True)
def test_a_delay_section_hardly_reduces_the_peak(numbers: dict[str, float]):
    assert numbers["delay over that wanted, optimised"] == pytest.approx(1, abs=1e-3)
    assert numbers["delay by the speed of long waves over that wanted"] == pytest.approx(
        1, abs=0.05
    )
    peak = "peak over that of equal beads, "
    assert (
        numbers[peak + "optimised"]
        > 0.99
        > numbers[peak + "larger piece"]
        > numbers[peak + "random"]
    )


@pytest.mark.soak  # Transfer matrices and runs of packets are tested in other files.
@pytest.mark.parametrize("numbers", ["filter"], indirect=True)
def test_a_filter_agrees_with_transfer_matrices_and_blocks_its_gap(numbers: dict[str, float]):
    for mass in (1, 2, 3):
        assert numbers[f"mass {mass}"] == pytest.approx(
            numbers[f"mass {mass} by transfer matrices"], rel=0.01
        )
    for packet in ("stopped", "passing"):
        by_run = numbers[f"{packet} packet, share that passes"]
        by_formula = f"{packet} packet, share by transfer matrices"
        assert by_run == pytest.approx(numbers[by_formula], abs=0.005)
    assert (
        numbers["stopped packet, share that passes"]
        < 0.05
        < 0.9
        < numbers["passing packet, share that passes"]
    )
    assert numbers["gap from"] < 0.45 < numbers["gap to"] < 0.8
