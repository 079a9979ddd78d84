"""A shock protector of 20 steel beads: diameters that minimise the force on a wall.

The first bead strikes at 1 m/s; it and the wall are as they are. The other 19 may have half to one
and a half times its diameter, and all together no more length than 20 equal ones. Random search has
as many seconds of the processor.

The protectors of Fraternali, Porter and Daraio (arXiv:0802.1451), found by an evolutionary
algorithm, change materials and order as well. Of that paper its abstract is known here: hard and
heavy beads at the loaded end, hard and soft ones by turns in the middle, soft and light ones at the
wall. Its beads, striker and forces are not, so that none is compared with. What stands in for it
has the same 20 beads, striker, steel wall and length: the best of all orders of that kind of equal
beads of steel and PTFE, whose diameters are then optimised by exact gradients; and an evolutionary
algorithm (SciPy's differential evolution) that chooses material and diameter of each bead, for as
many seconds of the processor, whose best diameters gradients improve.

`--all-orders` runs all 2^19 orders of equal beads of the two materials behind the striker (some six
minutes on two cores): no evolutionary algorithm, theirs or any other, can find a better order of
them than the best of these.
"""

import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from scipy.optimize import differential_evolution

sys.path.insert(0, str(Path(__file__).parents[1]))
from figures import arguments, finish, random_search, say

from lmpchain import Chain, Impulse, Scene
from lmpchain.design import PeakForce, optimise
from lmpchain.design.gradients import looks_of
from lmpchain.design.parameters import changed
from lmpchain.integrators.adjoint import DifferentiableRun
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.util.plotting import figure

BEADS = 20
SIZE = 1e-2
CHAIN = Chain(
    grains=BEADS, diameter=np.full(BEADS, SIZE), material="steel", gravity=0.0, bottom="wall"
)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1.0), duration=1.5e-3, samples=151)
LOW = np.full(BEADS, 0.5 * SIZE)
HIGH = np.full(BEADS, 1.5 * SIZE)
LOW[0] = HIGH[0] = SIZE
PEAK = PeakForce(BEADS)


def spare_length(by_name):
    """Return the relative excess of the length, and its derivatives."""
    return 1 - by_name["diameters"].sum() / (BEADS * SIZE), {
        "diameters": np.full(BEADS, -1 / (BEADS * SIZE))
    }


def wall_force(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the force on the wall over time."""
    looks = looks_of(scene, PEAK)
    run = DifferentiableRun(
        scene, SPLITTINGS["rkn4"], 1.0 / scene.highest_frequency, looks, np.array([BEADS])
    )
    return run.time, scene.chain.contacts.constant[BEADS] * np.maximum(
        run.displacement[:, 0], 0.0
    ) ** 1.5


def random_beads(rng: np.random.Generator) -> Scene:
    """Return the scene of random beads that fit."""
    diameters = np.clip(rng.uniform(LOW, HIGH), LOW, HIGH)
    if diameters.sum() > BEADS * SIZE:
        diameters[1:] *= (BEADS * SIZE - SIZE) / diameters[1:].sum()
        diameters = np.clip(diameters, LOW, HIGH)
    return changed(SCENE, {"diameters": diameters})


def composite(materials: list[str], diameters: np.ndarray, duration: float = 4e-3) -> Scene:
    """Return the scene of beads of these softer materials, with the same wall."""
    chain = CHAIN.replace(material=materials, diameter=diameters, bottom_material="steel")
    return SCENE.replace(chain=chain, duration=duration, samples=1 + round(duration * 1e5))


def best_of(orders: Iterable[list[str]]) -> tuple[float, list[str]]:
    """Return the smallest peak of equal beads over some orders, and the best order."""
    return min(
        (float(wall_force(composite(order, CHAIN.diameters))[1].max()), order) for order in orders
    )


def family() -> tuple[float, list[str]]:
    """Return the smallest peak of steel, alternating and PTFE beads in a row, and their order."""
    orders = []
    for hard in range(1, BEADS):
        for soft in range(BEADS - hard + 1):
            by_turns = [("ptfe", "steel")[k % 2] for k in range(BEADS - hard - soft)]
            orders.append(["steel"] * hard + by_turns + ["ptfe"] * soft)
    return best_of(orders)


def best_of_numbers(numbers: range) -> tuple[float, list[str]]:
    """Return the smallest peak over orders given as numbers, whose bits mark PTFE beads."""
    return best_of(
        ["steel", *(("steel", "ptfe")[number >> bead & 1] for bead in range(BEADS - 1))]
        for number in numbers
    )


def every_order() -> None:
    """Print the smallest peak over all orders of equal beads, and over the family."""
    count = 2 ** (BEADS - 1)
    some = 2**12
    pieces = [range(first, first + some) for first in range(0, count, some)]
    with ProcessPoolExecutor() as workers:
        least, order = min(workers.map(best_of_numbers, pieces))
    say("orders", count)
    say("best of all orders", least, "N")
    print("from the striker, s steel and p PTFE: " + "".join(name[0] for name in order))
    say("best of the family over best of all", family()[0] / least)
    began = time.process_time()
    found = optimise(
        composite(order, CHAIN.diameters),
        PEAK,
        ["diameters"],
        {"diameters": (LOW, HIGH)},
        [spare_length],
        starts=4,
        runs=150,
        tolerance=1e-3,
    )
    say("that order, diameters optimised", wall_force(found.scene)[1].max(), "N")
    say("time of that", time.process_time() - began, "s")


def evolution(seconds: float) -> tuple[float, Scene, int]:
    """Return the smallest peak by evolution in this CPU time, s, its scene, and the run count."""
    best = (np.inf, SCENE)
    tried = 0
    end = time.process_time() + seconds

    def peak(genes: np.ndarray) -> float:
        nonlocal best, tried
        tried += 1
        diameters = np.concatenate([[SIZE], LOW[1:] + genes[: BEADS - 1] * (HIGH - LOW)[1:]])
        diameters[1:] *= min(1.0, (BEADS * SIZE - SIZE) / diameters[1:].sum())
        if (diameters < LOW).any():
            return 1e6
        scene = composite(
            ["steel", *np.where(genes[BEADS - 1 :] < 0.5, "steel", "ptfe").tolist()], diameters
        )
        found = wall_force(scene)[1].max()
        best = min(best, (found, scene), key=lambda one: one[0])
        return found

    differential_evolution(
        peak, [(0, 1)] * (2 * BEADS - 2), maxiter=10**6, popsize=2, rng=3, polish=False,
        callback=lambda _at, convergence: time.process_time() > end,
    )  # fmt: skip
    return *best, tried


def draw_beads(axes: Axes, scene: Scene, height: float, colour: str) -> None:
    """Draw beads in a row, and the wall, at a height; light materials are white."""
    diameters = 1e3 * scene.chain.diameters
    centres = np.cumsum(diameters) - diameters / 2
    light = scene.chain.masses < 5000 * np.pi / 6 * scene.chain.diameters**3
    for x, diameter, soft in zip(centres, diameters, light, strict=True):
        face = "w" if soft else colour
        axes.add_patch(Circle((x, height), diameter / 2, fc=face, ec="0.2", lw=0.8))
    axes.plot([diameters.sum()] * 2, [height - 8, height + 8], color="0.3", lw=3)


def main() -> None:
    """Search with both methods, and draw the forces on the wall and the beads."""
    given = arguments(
        __file__, __doc__, all_orders="run all orders of equal beads, and nothing else"
    )
    if given.all_orders:
        return every_order()
    starts, runs = (2, 15) if given.quick else (8, 150)
    began = time.process_time()
    found = optimise(
        SCENE,
        PEAK,
        ["diameters"],
        {"diameters": (LOW, HIGH)},
        [spare_length],
        starts=starts,
        runs=runs,
        tolerance=1e-3,
    )
    took = time.process_time() - began
    random_peak, random_scene, tried = random_search(
        random_beads, lambda scene: wall_force(scene)[1].max(), took
    )
    equal = wall_force(SCENE)[1].max()
    least = wall_force(found.scene)[1].max()
    say("equal beads", equal, "N")
    say("optimised", least, "N")
    say("optimised over equal", least / equal)
    say("random search over equal", random_peak / equal)
    say("runs with gradients", found.runs)
    say("random beads tried", tried)
    say("time of each", took, "s")
    ordered, order = family()
    began = time.process_time()
    mixed = optimise(
        composite(order, CHAIN.diameters),
        PEAK,
        ["diameters"],
        {"diameters": (LOW, HIGH)},
        [spare_length],
        starts=starts // 2,
        runs=runs,
        tolerance=1e-3,
    )
    took = time.process_time() - began
    mixed_peak = wall_force(mixed.scene)[1].max()
    evolved, bred_scene, bred = evolution(took)
    both = optimise(
        bred_scene,
        PEAK,
        ["diameters"],
        {"diameters": (LOW, HIGH)},
        [spare_length],
        starts=1,
        runs=runs,
        tolerance=1e-3,
    )
    both_peak = wall_force(both.scene)[1].max()
    longer = wall_force(both.scene.replace(duration=12e-3, samples=1201))[1].max()
    say("best order of equal beads", ordered, "N")
    say("steel beads at its begin", order.index("ptfe"))
    say("that order, diameters optimised", mixed_peak, "N")
    say("optimised over best order", mixed_peak / ordered)
    say("runs with gradients of that order", mixed.runs)
    say("evolution", evolved, "N")
    say("runs of the evolution", bred)
    say("time of each of these", took, "s")
    say("evolution, then gradients", both_peak, "N")
    say("runs with gradients after the evolution", both.runs)
    say("peak in three times the time over that", longer / both_peak)
    picture = figure(7.5, 7.5)
    panels = picture.subplot_mosaic([["force", "search"], ["beads", "beads"]])
    over_time = panels["force"]
    search = panels["search"]
    beads = panels["beads"]
    cases = {
        "equal": SCENE,
        f"random, best of {tried}": random_scene,
        f"optimised, {found.runs} runs": found.scene,
    }
    cases |= {
        "equal, best order": composite(order, np.full(BEADS, SIZE)),
        "that order, optimised": mixed.scene,
    }
    cases["evolution, then optimised"] = both.scene
    colours = "0.5", "#E69F00", "#0072B2", "#CC79A7", "#009E73", "#D55E00"
    for place, ((name, scene), colour) in enumerate(zip(cases.items(), colours, strict=True)):
        at, force = wall_force(scene)
        over_time.semilogy(1e3 * at, force, color=colour, label=f"{name}: {force.max():.3g} N")
        draw_beads(beads, scene, -20.0 * place, colour)
        beads.text(-3, -20.0 * place, name.split(", best of")[0], ha="right", va="center")
    over_time.set(xlabel="time (ms)", ylabel="force on the wall (N)", ylim=(1, 1e5))
    over_time.set_title("Force on the wall")
    over_time.legend(title="largest force")
    found.plot(search)
    search.axhline(random_peak, color="#E69F00", ls="--", label="random, best")
    search.set(ylabel="least peak force so far (N)", xlabel="runs of each start, steel")
    search.set_title("Search by gradients, one line per start")
    search.legend(search.lines[-1:], ["random, best"])
    beads.set(
        xlim=(-95, 1e3 * BEADS * SIZE + 4), ylim=(-112, 12), xlabel="distance from the striker (mm)"
    )
    beads.set(aspect="equal", yticks=[], xticks=range(0, 201, 25))
    beads.set_title("Beads, struck from the left; white: PTFE")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
