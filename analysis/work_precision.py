"""Work-precision charts of every engine and integrator, with other codes if measured.

One picture and one file of numbers a scene, and a table: the time to four errors. Between the
points of a curve it is interpolated as a power law; where the longest step is better already, it is
the time of that.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from figures import finish, prepare_drawing

import lmpchain
from lmpchain.benchmark.bench import BUDGET_S, work_precision
from lmpchain.benchmark.chart import TARGET, draw, time_to
from lmpchain.benchmark.curves import CurvePoint, EngineCurve, WorkPrecision
from lmpchain.util.files import write_aside
from lmpchain.util.plotting import figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
SHOWN = {
    ("native", ""),
    ("native", "verlet"),
    ("native", "rkn4"),
    ("native", "rkn6"),
    ("lammps", "verlet"),
}
SCENES = ("weak", "fig5_1g", "fig1", "ten_thousand", "vacuum")


def at_the_end(name: str) -> lmpchain.Scene:
    """Return a scene recorded at its end only."""
    scene = lmpchain.Scene.from_toml(HERE / "scenes" / f"{name}.toml")
    return lmpchain.Scene(**scene.given() | {"samples": 2})


def others(name: str) -> list[dict[str, Any]]:
    """Return the points of other codes on a scene; the native engine is excluded."""
    path = HERE / "other_codes" / f"{name}.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []
    return [row for row in rows if not row["code"].startswith("native")]


def again(name: str, path: Path) -> WorkPrecision:
    """Return stored measurements for the chart and the table."""
    kept = json.loads(path.read_text(encoding="utf-8"))
    known = (
        {
            key: math.nan if value is None and key != "tolerance" else value
            for key, value in row.items()
        }
        for row in kept["rows"]
    )
    rows = [CurvePoint(**{"compile_s": 0.0} | row) for row in known]
    groups = groupby(
        rows, key=lambda point: (point.engine, "" if point.tolerance else point.integrator)
    )
    points = [(engine, integrator, tuple(each)) for (engine, integrator), each in groups]
    curves = tuple(
        EngineCurve(*each) if len(each[2]) > 1 else EngineCurve(each[0], "", each[2])
        for each in points
    )
    reference = SimpleNamespace(**kept["reference"])
    return WorkPrecision(
        at_the_end(name), reference, curves, kept["dropped"], (), kept["versions"], kept["machine"]
    )


def few(result: WorkPrecision, rows: list[dict[str, Any]]) -> Figure:
    """Draw the main curves: our engines, Verlet in LAMMPS, and the best other code."""
    curves = tuple(
        curve
        for curve in result.curves
        if len(curve.points) == 1
        or (curve.engine, "" if curve.to_tolerance else curve.integrator) in SHOWN
    )
    by_code = defaultdict(list)
    for row in rows:
        by_code[row["code"]].append(row)
    times = {
        code: time_to(TARGET, [(row["seconds"], row["error"]) for row in points])
        for code, points in by_code.items()
    }
    reached = {code: seconds for code, seconds in times.items() if seconds == seconds}
    best = by_code[min(reached, key=reached.__getitem__)] if reached else []
    picture = figure(7.5, 7.5)
    rooms = picture.subplot_mosaic(
        [["time", "evaluations"], ["bars", "bars"]], height_ratios=(3, 1.4)
    )
    draw(replace(result, curves=curves), list(rooms.values()), best)
    bars = rooms["bars"]
    names = [label.get_text().replace("lammps", "LAMMPS") for label in bars.get_yticklabels()]
    bars.set_yticks(bars.get_yticks(), names)
    explained = rooms["time"].get_legend_handles_labels()
    rooms["evaluations"].get_legend().remove()
    picture.legend(*explained, loc="outside lower center", ncols=4)
    return picture


def main() -> None:
    """Measure, print the tables and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help=f"some of {', '.join(SCENES)}; by default all"
    )
    parser.add_argument(
        "--budget", type=float, default=BUDGET_S, help="time for each, s (default: %(default)g)"
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=HERE / "pictures", help="folder for the pictures"
    )
    parser.add_argument(
        "--draw", action="store_true", help="draw the kept numbers again, without a measurement"
    )
    prepare_drawing(parser)
    given = parser.parse_args()
    for name in given.scenes or SCENES:
        kept = given.output / f"work_precision_{name}.json"
        result = (
            again(name, kept)
            if given.draw
            else work_precision(at_the_end(name), given.budget, progress=True)
        )
        measured = others(name)
        reached = defaultdict(list)
        for row in measured:
            reached[row["code"]].append((row["seconds"], row["error"]))
        print(f"{name}\n{result.table(reached)}")
        if not given.draw:
            with write_aside(kept, overwrite=True) as aside:
                aside.write_text(json.dumps(result.to_json()) + "\n", encoding="utf-8")
        finish(few(result, measured), kept.with_suffix(".png"))


if __name__ == "__main__":
    main()
