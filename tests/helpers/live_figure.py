"""The numbers of a live figure, decoded as in its script."""

import base64
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np

NOTHING = -(2**15)


def numbers_of(page: str | Path) -> dict[str, Any]:
    """Return the numbers in a page."""
    text = page.read_text(encoding="utf-8") if isinstance(page, Path) else page
    (found,) = re.findall(r'<script id="numbers" type="application/json">(.*?)</script>', text)
    return json.loads(found)


def arrays(numbers: dict[str, Any], run: int = 0) -> dict[str, Any]:
    """Return the arrays of one run, (T, G), (T,) or (G,), with `unit` of the velocity."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(numbers["data"])), np.uint8)
    low, high = planes.reshape(2, -1).astype(int)
    changes = low + 256 * high
    record = numbers["runs"][run]
    time = np.array(numbers["lists"][record["time"]])
    grains = np.array(numbers["lists"][record["grains"]])
    shapes = dict.fromkeys(("velocity", "displacement", "linear"), (time.size, grains.size))
    shapes |= dict.fromkeys(("kinetic", "total"), (time.size, 1))
    shapes |= dict.fromkeys(("front", "law"), (1, grains.size)) | {"rest": (1, grains.size - 1)}
    found: dict[str, Any] = {"time": time, "grains": grains, "limit": record["limit"]}
    for name, (rows, columns) in shapes.items():
        if record[name] is None:
            found[name] = None
            continue
        start, unit = record[name]
        part = changes[start : start + rows * columns].reshape(rows, columns)
        steps = np.cumsum(part, axis=0).astype(np.int16)
        values = np.where(steps == NOTHING, np.nan, steps * unit)
        found[name] = values if 1 not in (rows, columns) else values.ravel()
    return found | {"unit": record["velocity"][1], "facts": dict(record["facts"])}
