"""
Contact laws of your own
========================

Three famous lattices, each written as one formula: two solitons of Toda, the recurrence of Fermi,
Pasta, Ulam and Tsingou, and Newton's cradle. The dashed curves are exact or published results.
"""

from math import log, pi, sinh, sqrt

import matplotlib.pyplot as plt
import numpy as np

import lmpchain
from lmpchain import laws

plt.style.use("tableau-colorblind10")

# %%
# Toda's bonds, k (exp(b o) - 1) / b, have solitons that pass through each other. Dashed lines show
# where each would be without the other: the faster one ends ahead, the slower one behind. The two
# shifts agree with the closed form to 1e-9.
stiffness, b = 1e3, 1e5
toda = lmpchain.Chain(grains=340, diameter=1e-2, gravity=0.0, law=laws.toda(b, k=stiffness))
unit = sqrt(toda.masses[0] / stiffness)
kappa, start = np.array([1.2, 0.8]), np.array([35.0, 52.0])
contact = (sinh((kappa[0] - kappa[1]) / 2) / sinh((kappa[0] + kappa[1]) / 2)) ** 2


def tau(n):
    """Return the logarithm of Toda's tau function, and its rate."""
    phases = 2 * kappa[:, None] * (n - start[:, None])
    terms = np.array([0 * n, *phases, phases.sum(axis=0) + log(contact)])
    rates = np.array([0.0, *np.sinh(kappa), np.sinh(kappa).sum()])
    total = np.logaddexp.reduce(terms, axis=0)
    return total, -2 * rates @ np.exp(terms - total)


n = np.arange(1.0, 341.0)
place, speed = np.array(tau(n - 1)) - np.array(tau(n))
scene = lmpchain.Scene(
    chain=toda,
    excitation=lmpchain.Profile(displacement=(place - place[-1]) / b, velocity=speed / (b * unit)),
    duration=225 * unit,
    samples=181,
)
run = lmpchain.simulate(scene, "native", tolerance=1e-9)
overlap = -np.diff(run.displacement * b, axis=1)
time = run.time / unit
own_speeds = np.sinh(kappa) / kappa
frame = own_speeds.mean()
moving = n[:-1] + 0.5 - frame * time[:, None]
picture, meeting = plt.subplots(figsize=(7, 3.2), layout="constrained")
meeting.pcolormesh(moving, np.broadcast_to(time[:, None], moving.shape), overlap, rasterized=True)
for k, s, speed in zip(kappa, start, own_speeds, strict=True):
    # The slower soliton is ahead at first and has its shift already.
    ahead = s - (k == kappa[1]) * log(contact) / (2 * k)
    meeting.plot(ahead + 0.5 + (speed - frame) * time, time, "w--", linewidth=1)
meeting.set(xlabel="contact, in a moving frame", ylabel="time in $(m/k)^{1/2}$", xlim=(20, 70))
meeting.set_title("Toda")

# %%
# A sine on 31 grains between walls. Its energy wanders to modes 2, 3 and 4, and returns. The dashed
# line is the published time of 157 periods, computed in 1955 with a long time step; in exact time
# the energy returns after 146 periods.
size = 1e-6
fput = lmpchain.Chain(
    grains=31,
    diameter=1e-2,
    gravity=0.0,
    top="wall",
    bottom="wall",
    law=laws.fput(0.25 * stiffness / size, k=stiffness),
)
unit = sqrt(fput.masses[0] / stiffness)
number = np.arange(1, 32)
modes = np.sin(pi * np.outer(number, number) / 32) / 4
omega = 2 * np.sin(pi * number / 64)
period = 2 * pi / omega[0]


def mode_energies(engine):
    """Return time in periods of mode 1, and energies over that of the beginning."""
    sine = lmpchain.Profile(displacement=size * np.sin(pi * number / 32))
    steps = round(170 * period / sqrt(1 / 8))
    scene = lmpchain.Scene(
        chain=fput, excitation=sine, duration=steps * sqrt(1 / 8) * unit, samples=steps + 1
    )
    run = lmpchain.simulate(scene, engine, tolerance=1e-8)
    rates = run.velocity * unit / size @ modes
    energy = rates**2 + (omega * (run.displacement / size @ modes)) ** 2
    return run.time / unit / period, energy / energy[0, 0]


own_step = lmpchain.engines.Native("verlet", step=sqrt(1 / 8) * unit * (1 + 1e-9))
exact, published = mode_energies("native"), mode_energies(own_step)
picture_of_recurrence, recurrence = plt.subplots(figsize=(7, 3.2), layout="constrained")
for mode in range(4):
    color = f"C{mode}"
    recurrence.plot(exact[0], exact[1][:, mode], color, label=f"mode {mode + 1}")
recurrence.plot(published[0], published[1][:, 0], "C0:", label="mode 1, their step")
recurrence.axvline(157, color="k", linestyle="--", linewidth=1)
recurrence.set(xlabel="time in periods of mode 1", ylabel="energy", title="FPUT, alpha = 1/4")
recurrence.set_ylim(0, 1.25)
recurrence.legend(ncols=5, fontsize="small", loc="upper center")

# %%
# Newton's cradle of four steel balls, with Hertz's law as a formula; the dashed lines are the
# speeds of Hinch and Saint-Jean (1999).
balls = lmpchain.Chain(
    grains=4,
    material="steel",
    diameter=1e-2,
    gravity=0.0,
    bottom="free",
    law=lmpchain.Law("k*max(o, 0)**1.5", k=1e10),
)
strike = lmpchain.Impulse(velocity=0.1)
run = lmpchain.simulate(
    lmpchain.Scene(chain=balls, excitation=strike, duration=1e-4, samples=401), "native", 1e-9
)
picture_of_cradle, cradle = plt.subplots(figsize=(7, 3.2), layout="constrained")
for ball, last in enumerate([-0.07108502, -0.02962620, 0.10973864, 0.99097257]):
    cradle.plot(run.time * 1e6, run.velocity[:, ball] / 0.1, f"C{ball}", label=f"ball {ball + 1}")
    cradle.axhline(last, color=f"C{ball}", linestyle="--", linewidth=0.8)
cradle.set(xlabel="time (µs)", ylabel="velocity over that of the strike", title="Newton's cradle")
cradle.legend()
