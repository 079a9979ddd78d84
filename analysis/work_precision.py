"""Work-precision charts of every engine and integrator, with other codes where measured.

One picture and one file of numbers a scene, and a table: the time to four errors. Between the points of a curve it is
interpolated as a power law; where the longest step is better already, it is the time of that.
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

from figures import finish

import lmpchain
from lmpchain.benchmark.bench import BUDGET_S, work_precision
from lmpchain.util.files import write_aside

HERE = Path(__file__).parent
SCENES = ("weak", "fig5_1g", "fig1", "ten_thousand", "vacuum")


def at_the_end(name: str) -> lmpchain.Scene:
    """Return a scene recorded at its end only."""
    scene = lmpchain.Scene.from_toml(HERE / "scenes" / f"{name}.toml")
    return lmpchain.Scene(**scene.given() | {"samples": 2})


def others(name: str) -> list[dict[str, Any]]:
    """Return the points of other codes on a scene, without those of the native engine."""
    path = HERE / "other_codes" / f"{name}.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []
    return [row for row in rows if not row["code"].startswith("native")]


def main() -> None:
    """Measure, print the tables and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"some of {', '.join(SCENES)}; by default all")
    parser.add_argument("--budget", type=float, default=BUDGET_S, help="time for each, s (default: %(default)g)")
    parser.add_argument("-o", "--output", type=Path, default=HERE / "pictures", help="folder for the pictures")
    given = parser.parse_args()
    for name in given.scenes or SCENES:
        result = work_precision(at_the_end(name), given.budget, progress=True)
        measured = others(name)
        reached = defaultdict(list)
        for row in measured:
            reached[row["code"]].append((row["seconds"], row["error"]))
        print(f"{name}\n{result.table(reached)}")
        with write_aside(given.output / f"work_precision_{name}.json") as aside:
            aside.write_text(json.dumps(result.to_json()) + "\n", encoding="utf-8")
        finish(result.plot(others=measured), given.output / f"work_precision_{name}.png")


if __name__ == "__main__":
    main()
