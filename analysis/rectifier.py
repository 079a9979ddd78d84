"""An acoustic rectifier: a light sphere near the end of a chain driven in the gap above the band.

After Boechler, Theocharis and Daraio, Nature Materials 10, 665 (2011). Driven at the end with the
light sphere, the answer loses its stability in a Neimark-Sacker bifurcation, and the motion that
follows has frequencies of the band, which the chain transmits. Driven at the other end, it stays
what it is.
"""

import numpy as np
from figures import SHADES, arguments, finish, say

import lmpchain
from lmpchain import orbits
from lmpchain.util.plotting import figure

STEEL = lmpchain.Material(density=8000.0, youngs_modulus=193e9, poissons_ratio=0.3)
FREQUENCY = 10.5e3  # Hz, above the band of the chain, near the mode of the light sphere.
ROUNDING = 1e-12  # Amplitude in N below which spectra show rounding errors.
STRONGEST = 1.2e-6  # Amplitude of the drive, m.


def chain(light: int) -> lmpchain.Chain:
    """Return 19 steel spheres under 8 N, below a driven one, with a light sphere among them."""
    diameter = np.full(20, 19.06e-3)
    diameter[light - 1] = 11.9e-3
    drag = {"drag": 500.0}  # Motions decay in 4 ms.
    return lmpchain.Chain(
        grains=20,
        diameter=diameter,
        material=STEEL,
        gravity=0.0,
        top_load=8.0,
        bottom="wall",
        damping=drag,
    )


def transmitted(light: int, amplitude: float, quick: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """Return frequencies (Hz), and the spectrum (N) and variance (N²) of the far-wall force."""
    time = 0.05 if quick else 0.3
    drive = lmpchain.Drive(amplitude=amplitude, frequency=FREQUENCY)
    samples = int(20 * FREQUENCY * time) + 1
    scene = lmpchain.Scene(chain=chain(light), excitation=drive, duration=time, samples=samples)
    # Beyond the bifurcation only statistics of the motion are needed, so the step may be coarse.
    run = lmpchain.simulate(scene, "native", step=1e-6)
    force = lmpchain.measure.contact.contacts(run, [20]).change[:, 0]
    settled = force[samples // 2 :] - force[samples // 2 :].mean()
    window = np.hanning(settled.size)
    spectrum = np.abs(np.fft.rfft(settled * window)) * 2 / window.sum()
    frequency = np.fft.rfftfreq(settled.size, time / (samples - 1))
    return frequency, spectrum, float(settled.var())


def main() -> None:
    """Continue the responses to the drive at either end; draw them and spectra of runs."""
    given = arguments(__file__, __doc__)
    modes = lmpchain.theory.modes.eigenmodes(chain(3)).frequency / (2 * np.pi)
    say("upper end of the band", modes[-2] / 1e3, "kHz")
    say("mode of the light sphere", modes[-1] / 1e3, "kHz")
    picture = figure(7.5, 4)
    answer, sent = picture.subplots(1, 2)
    names = "driven at the light sphere", "driven at the other end"
    threshold = np.inf
    powers = {}
    for light, name, colour in zip((3, 18), names, (SHADES[5], SHADES[0]), strict=True):
        drive = lmpchain.Drive(amplitude=1e-8, frequency=FREQUENCY)
        family = orbits.follow(orbits.find(chain(light), drive=drive), "drive.amplitude", STRONGEST)
        size = np.array([orbit.response("force:1") for orbit in family])
        stable = family.stable
        for chosen, style in ((stable, "-"), (~stable, ":")):
            drawn = np.where(chosen, size, np.nan)
            answer.plot(1e6 * family.value, drawn, style, color=colour)
        answer.plot([], [], color=colour, label=name)
        say(f"events, {name}", len(family.events))
        for event in family.events:
            force = event.orbit.response("force:1")
            answer.plot(1e6 * event.value, force, "^", color=colour, mfc="none", label=event.kind)
            say(f"{event.kind}, {name}", 1e6 * event.value, "µm")
            turn = np.abs(np.angle(event.orbit.multipliers[0])) / (2 * np.pi)
            say("its second frequency", turn * FREQUENCY / 1e3, "kHz")
            threshold = min(threshold, event.value)
        for share in (0.9, 1.2):
            frequency, spectrum, variance = transmitted(light, share * threshold, given.quick)
            say(f"variance of the force at {share:g} thresholds, {name}", variance, "N²")
            powers[name, share] = variance
            label = f"{name}, {share:g} of the threshold"
            shade = {"color": colour, "lw": 0.8, "alpha": 1.0 if share > 1 else 0.45}
            sent.semilogy(frequency / 1e3, spectrum, label=label, **shade)
    say(
        "power sent on, over that of the other way, beyond the threshold",
        powers[names[0], 1.2] / powers[names[1], 1.2],
    )
    answer.set(xlabel="amplitude of the drive (µm)", ylabel="force at the driven sphere (N)")
    answer.set(ylim=(0, None))
    answer.set_title("Periodic answers, unstable ones dotted")
    answer.legend()
    sent.axvspan(0, modes[-2] / 1e3, color="0.9", lw=0, zorder=0)
    sent.set(xlabel="frequency (kHz)", ylabel="amplitude at the far wall (N)")
    sent.set(xlim=(0, 24), ylim=(1e-15, 1e3))
    sent.set_title("Spectra (Hann window), band shaded")
    sent.axhline(ROUNDING, color="0.5", lw=1, ls=":", zorder=0)
    sent.text(23.5, 0.5 * ROUNDING, "rounding errors", color="0.4", ha="right", va="top")
    sent.legend(loc="upper right")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
