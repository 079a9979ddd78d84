"""Scene files with a syntax slip: the message contains the remedy."""

from pathlib import Path

import pytest

from lmpchain import InputError, Scene
from lmpchain.trajectory.record import Cost

TEXT = """[chain]
grains = 10
diameter = 1e-3

[excitation]
kind = "impulse"
velocity = 1e-3

[recording]
duration = 1e-5
samples = 11
"""


def scene_in(folder: Path, text: str, mark: bytes = b"") -> Scene:
    """Return the scene of a file with this text, after some bytes."""
    file = folder / "scene.toml"
    file.write_bytes(mark + text.encode())
    return Scene.from_toml(file)


def test_a_byte_order_mark_is_allowed(tmp_path: Path):
    scene = scene_in(tmp_path, TEXT)
    assert scene_in(tmp_path, TEXT, b"\xef\xbb\xbf") == scene
    windows = TEXT.replace("\n", "\r\n")
    assert scene_in(tmp_path, windows, b"\xef\xbb\xbf") == scene


SLIPS = [
    ('"impulse"', "impulse", r"line 6.*text needs quotes, as in kind = \"impulse\""),
    ('"impulse"', "\u201cimpulse\u201d", r"line 6.*straight quotes"),
    ('"impulse"', '"impulse', r"line 6.*close the quotes"),
    ('"impulse"', "Impulse", r"line 6.*text needs quotes"),
    ("diameter", "material = [glass, steel]\ndiameter", r"line 3.*text needs quotes"),
    ("1e-5", "10 us", r"line 10.*number alone, in SI units"),
    ("1e-5", "1e-5 s", r"line 10.*number alone, in SI units"),
    ("1e-5", "1e-5s", r"line 10.*number alone, in SI units"),
    ("1e-5", "True", r"line 10.*true or false"),
    ("1e-5", "", r"line 10.*give a value"),
    ("= 1e-5", ": 1e-5", r"line 10.*write key = value"),
    ("1e-5", "0,1", r"line 10.*a point, not a comma"),
    ("1e-5", "1.e-5", r"line 10.*a digit after the point"),
    ("1e-5", ".1", r"line 10.*a digit before the point"),
    ("[recording]", "[recording", r"line 9.*close the bracket"),
    ("samples = 11", "duration = 1", r"give each key and each table once"),
    ("[recording]", "[chain]", r"give each key and each table once"),
    ("[chain]", 'engin = "native"\n[chain]', r"^engin: belongs to a run.*did you mean 'engine'"),
    ("[chain]", "tolerance = 1e-9\n[chain]", r"^tolerance: belongs to a run.*--tolerance"),
    ("[chain]", "duration = 1\n[chain]", r"^duration: belongs to a section.*\[recording\]"),
    ("[recording]", "[recordin]", r"^recordin: unknown section \(did you mean 'recording'\?\)"),
    ("diameter", "radius", r"^chain.radius: unknown key \(give the diameter, twice the radius\)"),
    ("grains", "grain", r"^chain.grain: unknown key \(did you mean 'grains'\?\)"),
    ("1e-5", "'1e-5'", r"^recording.duration: must be a number"),
    ("1e-5", "nan", r"^recording.duration: must be a finite number"),
    ("1e-5", "true", r"^recording.duration: must be a number"),
    ("1e-5", "2026-01-01", r"^recording.duration: must be a number"),
    ("1e-5", "07:32:00", r"^recording.duration: must be a number"),
    ("1e-5", "[1e-5]", r"^recording.duration: must be a number"),
    ("11", "11.0", r"^recording.samples: must be a whole number"),
    ("11", '"11"', r"^recording.samples: must be a whole number"),
    ("1e-3\n\n", '["1e-3"]\n\n', r"^chain.diameter: must be numbers, not text"),
    ("1e-3\n\n", "[1e-3, true]\n\n", r"^chain.diameter: must be numbers, not truth values"),
    ("1e-3\n\n", "[[1e-3]]\n\n", r"^chain.diameter: must be a list of numbers"),
    ("[chain]", "[[chain]]", r"^chain: must be a table"),
]


@pytest.mark.parametrize(("before", "after", "message"), SLIPS)
def test_a_slip_is_rejected_with_its_remedy(tmp_path: Path, before: str, after: str, message: str):
    with pytest.raises(InputError) as refusal:
        scene_in(tmp_path, TEXT.replace(before, after, 1))
    assert refusal.match(message.removeprefix("^") if "line" in message else message)
    assert "digit" not in str(refusal.value) or "digit" in message


def test_numbers_of_steps_as_text():
    cost = Cost(0.0, 0.0, 0.0, 1, 3, 10, "rkn4", 1e-6, 1)
    assert cost.steps_over(1e-6) == "1 step of 1e-06 s"
    fixed = cost._replace(steps=100)
    assert fixed.steps_over(1e-4) == "100 steps of 1e-06 s"
    # 233 steps of 1.563 us exceed 100 us, so the steps were adaptive.
    adaptive = cost._replace(steps=233, step_s=1.563e-6)
    assert adaptive.steps_over(1e-4) == "233 steps of 4.292e-07 s on average, 1.563e-06 s at most"
