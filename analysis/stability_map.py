"""Stability maps: the predictions of `lmpchain.stability.find` drawn over measurements.

One picture and one file of numbers a map, in `pictures/`; `maps/` holds one module for each.
"""

import argparse
import json
from importlib import import_module
from pathlib import Path
from typing import Any

from figures import finish, prepare_drawing

from lmpchain.util.files import write_aside

HERE = Path(__file__).parent
DIGITS = 6  # Digits of stored numbers.
MAPS = sorted(path.stem for path in (HERE / "maps").glob("[a-z]*.py"))


def _short(value: Any) -> Any:
    """Return numbers rounded to the stored digits."""
    if isinstance(value, dict):
        return {key: _short(value) for key, value in value.items()}
    if isinstance(value, list | tuple):
        return [_short(value) for value in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def main() -> None:
    """Measure and draw the maps."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "maps", nargs="*", metavar="MAP", help=f"some of {', '.join(MAPS)}; by default all"
    )
    parser.add_argument(
        "--quick", action="store_true", help="few points, for tests; goes into this folder"
    )
    parser.add_argument(
        "--draw", action="store_true", help="draw the kept numbers again, without a measurement"
    )
    parser.add_argument("-o", "--output", type=Path, help="folder; by default pictures")
    prepare_drawing(parser)
    given = parser.parse_args()
    if unknown := [name for name in given.maps if name not in MAPS]:
        parser.error(f"no map is called {unknown[0]}; there are {', '.join(MAPS)}")
    folder = given.output or (Path() if given.quick else HERE / "pictures")
    for name in given.maps or MAPS:
        module = import_module(f"maps.{name}")
        kept = folder / f"stability_{name}.json"
        if given.draw:
            numbers = json.loads(kept.read_text(encoding="utf-8"))
        else:
            numbers = _short(module.measure(given.quick))
            with write_aside(kept, overwrite=True) as aside:
                aside.write_text(json.dumps(numbers) + "\n", encoding="utf-8")
        finish(module.draw(numbers), folder / f"stability_{name}.png")


if __name__ == "__main__":
    main()
