"""The command `explore`: an HTML page with a slider for each key of a scene."""

from __future__ import annotations

import argparse
import math
from typing import Any

from ..errors import InputError, shown
from .common import STANDARD, collect, on_terminal, output, read_scene
from .read import PAGES

RUNS_OF_KEY = 15  # Number of values of a key for which none is given.
FORM = "KEY=LOW:HIGH[:N][:log], such as excitation.velocity=1e-6:1e-1:25:log"


def explore(arguments: argparse.Namespace) -> int:
    """Write a page with sliders that select among precomputed runs of a scene."""
    scene, path, *axes = collect(
        lambda: read_scene(arguments.scene),
        lambda: output(arguments.output, arguments.scene, PAGES, force=arguments.force),
        *((lambda text=text: read_axis(text)) for text in arguments.over),
    )
    from ..report.exploration import explore

    keys = [key for key, _ in axes]
    if twice := [key for key in dict.fromkeys(keys) if keys.count(key) > 1]:
        raise InputError.at(twice[0], "has two sliders: name each key once")
    # The file is passed on because a key may be absent from the file and have a default.
    known = scene if arguments.scene == STANDARD else arguments.scene
    source = {"scene": known, "over": dict(axes), "tolerance": arguments.tolerance}
    explore(source, path, progress=on_terminal(), overwrite=True)
    runs = math.prod(len(values) for _, values in axes)
    size = path.stat().st_size
    print(f"page: {path} ({runs} runs, {size / 1e6:.2g} MB)")
    return 0


def read_axis(text: str) -> tuple[str, list[Any]]:
    """Return the key and the values of a slider, from KEY=LOW:HIGH[:N][:log]."""
    key, _, span = text.partition("=")
    words = span.split(":")
    log = words[-1] == "log"
    bounds = words[:-1] if log else words
    if not key or len(bounds) not in (2, 3):
        raise InputError.at("over", f"must be {FORM} (got {shown(text)})")
    low, high = (_number(key, word) for word in bounds[:2])
    count = _count(key, bounds[2]) if len(bounds) == 3 else RUNS_OF_KEY
    if not low < high:
        raise InputError.at(key, f"the range must ascend (got {low:g}:{high:g})")
    if log and low <= 0:
        raise InputError.at(key, f"a range in equal ratios must begin above 0 (got {low:g})")
    # NumPy is imported late, because the help does not need it.
    import numpy as np

    values = (np.geomspace if log else np.linspace)(low, high, count)
    # A range with two integer ends gets integer values.
    if all(word.lstrip("+-").isdecimal() for word in bounds[:2]):
        whole = np.unique(values.round().astype(int)).tolist()
        if log or len(whole) < count or np.allclose(values, whole):
            return key, whole
    return key, values.tolist()


def _count(key: str, word: str) -> int:
    # A number with more digits is rejected later in any case.
    count = int(word[:9]) if word.isdecimal() else 0
    if count < 2:
        raise InputError.at(key, f"the number of runs must be 2 or more (got {shown(word)})")
    return count


def _number(key: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError.at(key, f"the ends of the range must be numbers (got {shown(word)})")
    return value
