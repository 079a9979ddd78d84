"""Tables of the numbers stored in pictures, for pages that do not show the picture.

    python analysis/kept_tables.py

Every picture holds the numbers that its script printed. Writes tables/protector.md, which
docs/design.md shows, and tables/shock_edges.md, which docs/exact.md shows.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from figures import HERE, TABLES, write_table
from PIL import Image

PROTECTORS = {  # Name of the force in the script, by method.
    "equal beads of steel": "equal beads",
    "steel, diameters by random search": "random search over equal",
    "steel, diameters by gradients": "optimised",
    "steel and PTFE, equal beads in the best order of the published kind": (
        "best order of equal beads"
    ),
    "that order, diameters by gradients": "that order, diameters optimised",
    "materials and diameters by an evolutionary algorithm": "evolution",
    "these, then diameters by gradients": "evolution, then gradients",
}


def kept(picture: str) -> dict[str, float]:
    """Return the numbers stored in a picture."""
    with Image.open(HERE / picture) as shown:
        return json.loads(shown.info["Numbers"])


def protectors() -> Iterator[tuple[str, ...]]:
    """Yield the largest forces on the wall behind 20 beads."""
    numbers = kept("design/pictures/protector.png")
    for way, name in PROTECTORS.items():
        unit = numbers["equal beads"] if name.endswith("over equal") else 1.0
        yield way, f"{numbers[name] * unit:.3g}"


def shock_edges() -> Iterator[tuple[str, ...]]:
    """Yield deviations of dispersive shock edges from Whitham's theory, in speeds of sound."""
    numbers = kept("pictures/shocks.png")
    name = "{} edge off Whitham's, in that of sound, jump {}"
    start = name.format("leading", "")
    for jump in [label.removeprefix(start) for label in numbers if label.startswith(start)]:
        cells = []
        for edge in ("leading", "trailing"):
            off = numbers[name.format(edge, jump)]
            error = numbers[f"its error, {edge} edge, jump {jump}"]
            # NaN marks an edge that was not found.
            cells.append(f"{off:+.4f} ± {error:.4f}".replace("-", "−") if off == off else "-")
        yield jump, *cells


def main(folder: Path) -> None:
    """Write both tables."""
    write_table(folder / "protector.md", ("20 beads", "largest force on the wall, N"), protectors())
    write_table(
        folder / "shock_edges.md",
        ("overlap behind over that ahead", "leading edge", "trailing edge"),
        shock_edges(),
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=TABLES)
    main(parser.parse_args().folder)
