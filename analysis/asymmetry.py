"""Rise and fall of the pulse of a struck column: the paper's "pronounced asymmetry" of Eq. (35).

The displacement rises within some grains' travel time, w ~ h^(1/6), and falls as (tau^2 -
chi^2)^(-1/10), a long tail. Points are Eq. (1) by the native engine, lines the front of Airy type
for the rise and the causal Eq. (35) for the fall, from the height of the run. Widths are times from
half of the largest displacement to it and back to half. The velocity, its slope, has no tail: it
falls even faster than it rises, and oscillates behind.
"""

import numpy as np
from figures import NATIVE, SHADES, THEORY, apart, arguments, finish, legends, page, say, weak_scene

import lmpchain
from lmpchain.theory import continuum, front

DEEPEST = 300
GRAINS = 600


def halves(tau: np.ndarray, motion: np.ndarray) -> tuple[float, float, float]:
    """Return the time of the maximum, and the rise and fall times between it and half of it."""
    top = int(motion.argmax())
    before, here, after = motion[top - 1 : top + 2]
    shift = 0.5 * (before - after) / (before - 2 * here + after)
    half = (here - 0.25 * (before - after) * shift) / 2
    at = tau[top] + shift * (tau[1] - tau[0])
    up = int(np.flatnonzero(motion[:top] < half)[-1])
    down = top + int(np.flatnonzero(motion[top:] < half)[0])
    first = np.interp(half, motion[up : up + 2], tau[up : up + 2])
    last = np.interp(-half, -motion[down - 1 : down + 1], tau[down - 1 : down + 1])
    return at, at - first, last - at


def predicted(n: int, largest: float) -> tuple[float, float]:
    """Return rise and fall times of the displacement: Airy front, then causal Eq. (35) to half."""
    chi = float(continuum.chi(n - 0.5))
    width = (n - 0.5) ** (1 / 6) / 4 ** (1 / 3)
    tau = chi + np.linspace(-6, 6, 481) * width
    near = front.displacement(n, tau)
    top = tau[near.argmax()]
    height = near.max()
    rise = top - np.interp(height / 2, near[: near.argmax()], tau[: near.argmax()])
    end = np.sqrt(chi**2 + (largest / (2 * continuum.impulse_amplitude())) ** -10)
    return rise, end - top


def main() -> None:
    """Strike a column; draw pulses, and their rise and fall times against depth."""
    given = arguments(__file__, __doc__)
    deepest, grains = (50, 260) if given.quick else (DEEPEST, GRAINS)
    shown = (10, deepest)
    # The reflected pulse is cut off.
    tau_end = 2 * float(continuum.chi(grains - 0.5)) - float(continuum.chi(deepest - 0.5)) - 20
    depths = np.unique([*np.geomspace(2, deepest, 16).astype(int), *shown])
    scene = weak_scene(grains, tau_end, int(10 * tau_end), 1e-8, recorded=depths.tolist())
    run = lmpchain.simulate(scene, "native", tolerance=1e-8)
    tau = run.time / scene.chain.time_scale
    phi = dict(
        zip(
            depths,
            run.displacement.T / scene.excitation.velocity / scene.chain.time_scale,
            strict=True,
        )
    )
    v = dict(zip(depths, run.velocity.T / scene.excitation.velocity, strict=True))

    picture, ((pulse, below), (width, off)) = page(2)
    for n, shade in zip(shown, SHADES, strict=False):
        chi = float(continuum.chi(n - 0.5))
        w = (n - 0.5) ** (1 / 6) / 4 ** (1 / 3)
        s = (tau - chi) / w
        height = phi[n].max()
        tail = continuum.impulse_response(n - 0.5, tau) / height
        near = (s > -6) & (s < 12)
        airy = front.displacement(n, tau[near]) / height
        shape = phi[n] / height
        every = np.unique(
            np.concatenate(
                (np.flatnonzero(near)[:: int(4 * w)], np.flatnonzero(s >= 12)[:: int(20 * w)])
            )
        )
        pulse.plot(s[every], shape[every], **NATIVE | {"color": shade}, label=f"native, grain {n}")
        pulse.plot(s[near], airy, color=shade, lw=1)
        pulse.plot(s[s > 1], tail[s > 1], color=shade, lw=1, ls="--")
        apart(below, s[near], airy, shape[near], 1.0, color=shade, lw=1)
        apart(below, s[s > 1], tail[s > 1], shape[s > 1], 1.0, color=shade, lw=1, ls="--")
    pulse.plot([], [], **THEORY, label="front of Airy type")
    pulse.plot([], [], **THEORY | {"ls": "--"}, label="causal Eq. (35)")
    pulse.axhline(0.5, color="0.6", ls=":", lw=1)
    pulse.set(ylabel="displacement / its largest", xlim=(-6, 40), ylim=(-0.05, 1.5))
    below.set(
        xlabel="time since the light cone / width w of the front",
        ylabel="|theory − native|",
        ylim=(1e-7, 2),
    )

    _, rise, fall = np.array([halves(tau, phi[n]) for n in depths]).T
    theory_rise, theory_fall = np.array([predicted(n, phi[n].max()) for n in depths]).T
    _, up, down = np.array([halves(tau, v[n]) for n in depths]).T
    last = depths[-1]
    for measured, theory, mark, shade, name in (
        (fall, theory_fall, "v", SHADES[5], "fall of the displacement"),
        (rise, theory_rise, "^", SHADES[0], "rise of the displacement"),
    ):
        style = {"color": shade, "marker": mark, "ms": 5, "mfc": "none"}
        error = 100 * abs(measured[-1] / theory[-1] - 1)
        width.loglog(
            depths, measured, ls="none", **style, label=f"{name}: {error:.1g} % off at {last}"
        )
        width.loglog(depths, theory, color=shade, lw=1.2)
        apart(off, depths, theory / measured, np.ones(depths.size), 1.0, lw=0.7, **style)
    width.loglog(depths, down, "v", ms=3, color=SHADES[2], label="fall of the velocity")
    width.loglog(depths, up, "^", ms=3, color=SHADES[3], label="rise of the velocity")
    width.set(ylabel="time to or from half, τ", ylim=(0.4, 3000))
    off.set(xlabel="grain, from the top", ylabel="|theory / native − 1|")
    for n in (10, int(last)):
        _, a, b = halves(tau, phi[n])
        say(f"fall / rise of the displacement at grain {n}", b / a)
        _, a, b = halves(tau, v[n])
        say(f"fall / rise of the velocity at grain {n}", b / a)
    say("exponent of the rise", np.polyfit(np.log(depths[-8:]), np.log(rise[-8:]), 1)[0])
    say("exponent of the fall", np.polyfit(np.log(depths[-8:]), np.log(fall[-8:]), 1)[0])
    say("rise, theory off by", 100 * abs(rise[-1] / theory_rise[-1] - 1), "%")
    say("fall, theory off by", 100 * abs(fall[-1] / theory_fall[-1] - 1), "%")
    legends(picture)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
