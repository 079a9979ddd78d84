"""Peak velocity, time and energy of a weak strike against depth, for several exponents.

Points are Eq. (1) by the native engine, lines the front of Airy type (`theory.front`), of which the
next order is some 0.34 n^(-1/3). A column of n grains answers so at its lowest grain until the
floor does, so depth stands for the length of the chain as well. Not h^(-1/12), which is for waves
of one frequency: peak velocities fall as h^(-4/15) for Hertz.
"""

import numpy as np
from figures import SHADES, THEORY, apart, arguments, finish, legends, page, say, weak_scene
from scipy.integrate import trapezoid

import lmpchain
from lmpchain.measure import front as measured
from lmpchain.theory import continuum, front

DELTAS = (1.0, 1.25, 1.5, 2.0, 2.5)
FURTHER = (1.1, 1.35, 1.7, 1.85)  # Used only in the table of exponents.
DEEPEST = 1000
PER_TAU = 12
NEXT = 0.34  # Exponent of the next order for Hertz's law.


def strike(depths: np.ndarray, delta: float) -> lmpchain.Trajectory:
    """Strike a column weakly and record it until the first pulse has passed these grains."""
    deepest = int(depths[-1])
    tau = float(front.peak_time(deepest, delta)) + 8 * deepest ** (1 / 3 - (1 - 1 / delta) / 2)
    grains = int(continuum.depth(tau, delta)) + 20  # The wave does not reach the floor.
    recorded = np.union1d(
        depths, depths + 1
    ).tolist()  # The next grains are included for the work done on them.
    scene = weak_scene(grains, tau, int(PER_TAU * tau) + 1, 1e-8, delta, recorded=recorded)
    return lmpchain.simulate(scene, "native", tolerance=1e-8)


def carried(run: lmpchain.Trajectory, grain: int, until: float) -> float:
    """Return the work of a grain on the next one up to a time, relative to the strike's energy."""
    now = run.time <= until
    chain = run.scene.chain
    at = int(np.searchsorted(run.grains, grain))
    force = chain.linear_stiffness[grain - 1] * (
        run.displacement[now, at] - run.displacement[now, at + 1]
    )
    work = trapezoid(force * run.velocity[now, at + 1], run.time[now])
    return float(work / (0.5 * chain.masses[0] * run.scene.excitation.velocity**2))


def theory_carried(depths: np.ndarray, delta: float) -> np.ndarray:
    """Return the work of each grain on the next one by `theory.front`.

    It is 2 sqrt(kappa) times the integral of v^2.
    """
    n = 100
    xi = 1 - 1 / delta
    peak = float(front.peak_time(n, delta))
    at = peak + np.linspace(-12, 6, 601) * n ** (1 / 3 - xi / 2)
    v = front.velocity(n, at, delta)
    last = np.flatnonzero((at > peak) & (v <= 0))[0]
    here = 2 * (n - 0.5) ** (xi / 2) * trapezoid(v[:last] ** 2, at[:last])
    # Product of the powers of depth.
    return here * ((depths - 0.5) / (n - 0.5)) ** (1 / 3 - 2 * front.decay(delta)[0])


def main() -> None:
    """Strike columns of several exponents; draw velocity, time and energy against depth."""
    given = arguments(__file__, __doc__)
    deepest, deltas, further = (200, (1.0, 1.5), ()) if given.quick else (DEEPEST, DELTAS, FURTHER)
    picture, ((speed, speed_off), (power, power_off)) = page(2)
    supplement, ((time, time_off), (energy, energy_off)) = page(2)
    depths = np.unique(np.geomspace(5, deepest, 40).astype(int))
    exponents = []
    for place, delta in enumerate(sorted((*deltas, *further))):
        run = strike(depths, delta)
        passed = measured.track(run)
        if delta <= 2:  # For larger exponents, the asymptotic law is not reached.
            law = measured.asymptotic(passed.between(deepest // 10, deepest), "amplitude", delta)
            exponents.append((delta, -law.exponent, law.error[0]))
        if delta not in deltas:
            continue
        shade = SHADES[deltas.index(delta)]
        unit = run.scene.chain.time_scale
        rows = np.searchsorted(passed.grain, depths)
        v = passed.amplitude[rows] / run.scene.excitation.velocity
        t = passed.time[rows] / unit
        theory_v = front.peak_velocity(depths, delta)
        theory_t = front.peak_time(depths, delta)
        behind = [
            run.time[(run.time > at) & (run.velocity[:, np.searchsorted(run.grains, n)] <= 0)][0]
            for n, at in zip(depths, passed.time[rows], strict=True)
        ]
        e = np.array([carried(run, n, until) for n, until in zip(depths, behind, strict=True)])
        theory_e = theory_carried(depths, delta)
        marks = {"ls": "none", "marker": "osD^v"[place % 5], "ms": 4, "mfc": "none", "color": shade}
        for axes, below, values, line in (
            (speed, speed_off, v, theory_v),
            (time, time_off, t, theory_t),
            (energy, energy_off, e, theory_e),
        ):
            off = abs(values[-1] / line[-1] - 1)
            bounded = line if axes is not energy else np.where(line <= 1, line, np.nan)
            axes.loglog(depths, bounded, color=shade, lw=1.2)
            axes.loglog(
                depths,
                values,
                **marks,
                label=f"δ = {delta:g}: {100 * off:.2g} % off",
            )
            apart(
                below,
                depths,
                values / line,
                np.ones(depths.size),
                1.0,
                **marks | {"ls": "-", "lw": 0.6},
            )
        if delta == 1.5:
            corrected = theory_v * (1 - NEXT * depths ** (-1 / 3))
            last = 100 * abs(v[-1] / corrected[-1] - 1)
            speed.loglog(
                depths,
                corrected,
                "--",
                color=shade,
                lw=1.2,
                label=f"δ = 1.5, corrected: {last:.2g} %",
            )
            apart(
                speed_off,
                depths,
                v / corrected,
                np.ones(depths.size),
                1.0,
                color=shade,
                ls="--",
                lw=1,
            )
            say(
                "peak velocity at the deepest grain, delta = 1.5, with its correction",
                corrected[-1],
            )
        say(f"peak velocity at the deepest grain, delta = {delta:g}", v[-1])
        say(f"its theory, delta = {delta:g}", theory_v[-1])
        say(f"arrival at the deepest grain, delta = {delta:g}", t[-1])
        say(f"its theory, delta = {delta:g}, arrival", theory_t[-1])
        say(f"energy in the first pulse at the deepest grain, delta = {delta:g}", e[-1])
        say(f"its theory, delta = {delta:g}, energy", theory_e[-1])
    delta, p, error = np.array(exponents).T
    fine = np.linspace(1, 2.6, 100)
    power.plot(
        fine,
        [-front.decay(x)[0] for x in fine],
        **THEORY,
        label="velocity: −4/15 for Hertz",
    )
    power.plot(
        fine,
        [-front.decay(x)[1] for x in fine],
        **THEORY | {"ls": ":"},
        label="displacement: −1/10",
    )
    power.errorbar(delta, -p, error, ls="none", marker="s", ms=4, mfc="none", color=SHADES[0],
                   label="velocity, fitted")  # fmt: skip
    expected = np.array([front.decay(x)[0] for x in delta])
    apart(
        power_off,
        delta,
        p,
        expected,
        1.0,
        color=SHADES[0],
        marker="s",
        ls="none",
        label="fit − theory",
    )
    power_off.plot(delta, error, color="0.5", marker="_", ls="none", label="error of the fit")
    hertz = list(delta).index(1.5)
    say("fitted exponent of the peak velocity, Hertz", p[hertz])
    say("error of the fitted exponent, Hertz", error[hertz])
    labels = ("peak velocity / $v_0$", "time of the peak, τ", "energy in the first pulse / $E_0$")
    for axes, label in zip((speed, time, energy), labels, strict=True):
        axes.set_ylabel(label)
    power.set(ylabel="exponent p of $h^p$", ylim=(-0.36, 0.12))
    for lower in (speed_off, time_off, energy_off):
        lower.set(xlabel="grain n, or length of the chain", ylabel="|run / theory − 1|")
    power_off.set(xlabel="exponent δ of the contacts", ylabel="difference")
    for axes, ticks in ((speed, (0.1, 0.2, 0.3, 0.5)), (energy, (0.2, 0.5, 1))):
        axes.set_yticks(ticks)
        axes.yaxis.set(major_formatter="{x:g}", minor_formatter="")
    for drawn, path in (
        (picture, given.output),
        (supplement, given.output.with_stem(given.output.stem + "_supplement")),
    ):
        legends(drawn)
        finish(drawn, path)


if __name__ == "__main__":
    main()
