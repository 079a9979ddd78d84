"""
Resonance curves of damped, driven chains
=========================================

The periodic answer of a damped chain to a drive, stable or not, through the folds of a resonance.
"""

import lmpchain
from lmpchain import orbits

chain = lmpchain.Chain(
    grains=5,
    diameter=1e-2,
    material="steel",
    gravity=0.0,
    top_load=20.0,
    bottom="wall",
    damping={"drag": 500.0},
)
drive = lmpchain.Drive(amplitude=1e-7, frequency=10.4e3)
curve = orbits.follow(orbits.find(chain, drive=drive), "drive.frequency", 14e3)
for event in curve.events:
    print(f"{event.kind} at {event.value / 1e3:.3f} kHz")
picture = curve.plot(of="force:1")

# %%
# Followed in the amplitude instead, at a frequency below a resonance.
below = orbits.find(chain, drive=drive.replace(frequency=11.2e3, amplitude=1e-8))
family = orbits.follow(below, "drive.amplitude", 3e-7)
picture_of_amplitudes = family.plot(of="force:1")
