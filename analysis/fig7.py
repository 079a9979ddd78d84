"""Fig. 7 of the paper, the "3D display of the influence of the Dyson disorder", as maps.

Left: the sum of Eq. (22) for one ordered column. Its size at large m follows the motion of grain 1
alone, of which kappa is 1. Right: the largest mean velocity over columns whose kappa_n are drawn
from Dyson's distribution. Below: the sum with the velocities of the native engine against that with
Eq. (19), and the standard error of the mean.
"""

import numpy as np
from figures import OUTLINE, SHADES, arguments, finish, kappa, legends, page, say, weak_scene
from matplotlib.colors import SymLogNorm
from scipy.ndimage import gaussian_filter

import lmpchain
from lmpchain.disorder.averages import ensemble
from lmpchain.theory import bessel, dyson

GRAINS = 60
TAU = 30
SAMPLES = 61
ORDERS = (1, 1.4, 2, 3, 4, 5, 7, 10, 14, 20, 30, 50, 70, 100)


def main() -> None:
    """Run the columns and draw the maps."""
    given = arguments(__file__, __doc__)
    orders, columns = (ORDERS[::3], 10) if given.quick else (ORDERS, 100)
    scene = weak_scene(GRAINS, TAU, SAMPLES, 1e-7)
    run = lmpchain.simulate(scene, "native", tolerance=1e-9)
    velocity = run.velocity / scene.excitation.velocity
    tau = scene.time / scene.chain.time_scale
    n = np.arange(1, GRAINS + 1)
    linear = np.zeros((SAMPLES, GRAINS))
    linear[:, :-1] = bessel.finite(kappa(GRAINS), n[:-1], 1, tau[:, None])

    picture, ((weighted, below), (mean, noise)) = page(2)
    m = np.geomspace(1, 100, 81)
    sums, theory = (
        np.array([dyson.average(v, n ** (1 / 3), order) for order in m]) for v in (velocity, linear)
    )
    most = np.ceil(np.abs(sums).max())
    scale = SymLogNorm(0.1, vmin=-most, vmax=most)
    image = weighted.pcolormesh(tau, m, sums, norm=scale, cmap="PuOr", shading="gouraud")
    label = "Eq. (22): Σ weight × velocity / $v_0$"
    picture.colorbar(
        image, ax=weighted, label=label, ticks=[-most, -1, -0.1, 0, 0.1, 1, most], format="{x:g}"
    )
    off = np.abs(sums - theory).max(0)
    below.plot(tau[1:], off[1:], color=SHADES[0], label=f"native − Eq. (19): {off.max():.0e}")

    averages = [ensemble(scene, order, columns, seed=1) for order in orders]
    largest = (
        np.array([average.velocity.max(1) for average in averages]) / scene.excitation.velocity
    )
    image = mean.pcolormesh(
        tau, orders, largest, cmap="viridis", vmin=0, vmax=0.5, shading="gouraud"
    )
    smooth = gaussian_filter(largest, (0.7, 1.5))
    lines = mean.contour(
        tau,
        orders,
        smooth,
        levels=(0.1, 0.2, 0.3, 0.4),
        colors="w",
        linewidths=1,
    )
    for text in mean.clabel(lines, colors="k", manual=[(6, 14), (13, 10), (18, 5), (22, 1.5)]):
        text.set_path_effects(OUTLINE)
    picture.colorbar(image, ax=mean, label="largest mean velocity / $v_0$", extend="max")
    for place, shade in zip((0, len(orders) // 2, len(orders) - 1), SHADES, strict=False):
        average = averages[place]
        error = (
            average.velocity_error[np.arange(SAMPLES), average.velocity.argmax(1)]
            / scene.excitation.velocity
        )
        noise.plot(tau[1:], error[1:], color=shade, label=f"m = {orders[place]}")

    weighted.set_title("One column, weighted sum")
    mean.set_title(f"{columns} columns, smoothed contours")
    for axes in (weighted, mean):
        axes.set(yscale="log", xlim=(0, TAU), ylabel="order m (large: little disorder)")
    below.set(xlabel="time τ", ylabel="|difference|", ylim=(1e-10, 1e-4))
    noise.set(xlabel="time τ", ylabel="error of the mean", ylim=(1e-5, 1e4))
    say("Eq. (22) at tau 15, m = 1", float(dyson.average(velocity[30], n ** (1 / 3), 1)))
    say("Eq. (22), native and Eq. (19) differ by", off.max())
    for place in (0, -1):
        say(
            f"mean over columns at tau 15, m = {orders[place]}, largest velocity",
            largest[place, 30],
        )
    legends(picture, loc="upper right")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
