"""Fig. 6 of the paper: the effect of Dyson's disorder on the wave.

Left: the sum of Eq. (22) over the velocities of one ordered column, weighted with Eq. (23), against
the order m. It is no average: its weights do not add up to 1, and it grows without bound as m does.
Right: what "the velocity averaged over disorder" should mean: the mean over columns whose kappa_n
are drawn from Dyson's distribution. There the claim of the paper holds: more disorder, less
velocity.
"""

import numpy as np
from figures import (
    NATIVE,
    PRINTED,
    SHADES,
    THEORY,
    apart,
    arguments,
    finish,
    kappa,
    legends,
    page,
    say,
    weak_scene,
)
from matplotlib import colormaps

import lmpchain
from lmpchain.disorder.averages import ensemble
from lmpchain.theory import bessel, dyson

GRAINS = 60
TAU = 15
ORDERS = (1, 2, 5, 20, 100)


def main() -> None:
    """Run the ordered column and the disordered ones, and draw both averages."""
    given = arguments(__file__, __doc__)
    scene = weak_scene(GRAINS, TAU, 2, 1e-7)
    run = lmpchain.simulate(scene, "native", tolerance=1e-9)
    velocity = run.velocity[-1] / scene.excitation.velocity
    n = np.arange(1, GRAINS + 1)
    linear = np.append(bessel.finite(kappa(GRAINS), n[:-1], 1, float(TAU)), 0.0)

    picture, ((weighted, below), (wave, noise)) = page(2)
    m = np.geomspace(1, 1e4, 400)
    coarse = np.geomspace(1, 1e4, 25)
    for style, label, normalised in (
        (PRINTED, "as printed", False),
        (THEORY, "divided by the weights", True),
    ):
        line, points = (
            dyson.average(v, n ** (1 / 3), order, normalised)
            for v, order in ((linear, m), (velocity, coarse))
        )
        at_points = dyson.average(linear, n ** (1 / 3), coarse, normalised)
        weighted.plot(m, line, **style, label=f"Eq. (22) {label}")
        off = np.abs(points - at_points).max()
        weighted.plot(
            coarse,
            points,
            **NATIVE | {"color": style["color"]},
            label=f"with native velocities: {off:.0e} off",
        )
        apart(below, coarse, points, at_points, 1.0, **style)
    limit = np.sqrt(m / (2 * np.pi)) * linear[0]
    late = r"$\sqrt{m / 2π}\; v_1$"
    weighted.plot(m[m > 30], limit[m > 30], color=SHADES[1], ls=":", label=late)
    weighted.set(xscale="log", ylabel="Σ weight × velocity / $v_0$", ylim=(-0.4, 0.5))
    below.set(
        xlabel="order m (large: little disorder)", ylabel="|native − theory|", ylim=(1e-11, 1e-5)
    )
    for order in (1, 3, 5, 100, 1e4):
        say(f"Eq. (22), m = {order:g}", dyson.average(linear, n ** (1 / 3), order))

    columns = 12 if given.quick else 200
    wave.plot(n, linear, **THEORY, label=f"ordered: max {linear.max():.3f}")
    say("ordered, largest velocity", linear.max())
    # The paper's formula is drawn in green, left.
    shades = colormaps["plasma"](np.linspace(0.0, 0.85, len(ORDERS)))
    for order, shade in zip(ORDERS, shades, strict=True):
        average = ensemble(scene, order, columns, seed=1)
        mean, error = (
            v[-1] / scene.excitation.velocity for v in (average.velocity, average.velocity_error)
        )
        label = f"m = {order}: max {mean.max():.3f} ± {error[mean.argmax()]:.3f}"
        wave.errorbar(n, mean, error, color=shade, marker="o", ms=2.5, lw=1, label=label)
        apart(noise, n, mean, linear, linear.max(), color=shade, lw=1)
        say(f"mean over columns, m = {order}, largest velocity", mean.max())
        say(f"its standard error, m = {order}", error[mean.argmax()])
    wave.set(xlim=(0, 30), ylabel="mean velocity / $v_0$")
    noise.set(xlabel="grain, from the top", ylabel="|mean − ordered| / max", ylim=(1e-4, 2))
    weighted.set_title("One column, weighted sum")
    wave.set_title(f"Mean over {columns} columns ± standard error")
    wave.set_ylim(-0.25, 0.75)
    legends(picture)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
