"""
Lyapunov spectrum and alignment indices
=======================================

Five beads between walls, without a load: all motions are chaotic. The exponents come in pairs of
opposite sign, and those of the energy are 0.
"""

import lmpchain
from lmpchain import orbits

chain = lmpchain.Chain(
    grains=5, material="steel", diameter=5e-3, gravity=0.0, top="wall", bottom="wall"
)
scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=0.1), duration=0.05)
found = orbits.chaos_of(scene)
for exponent, half_width in zip(found.exponent, found.half_width, strict=True):
    print(f"{exponent:8.0f} ± {half_width:.0f} per second")
picture_of_exponents = found.plot()

# %%
# Three beads under a load move regularly on a torus of three dimensions: the indices of up to three
# deviations stay, and those of k fall as the power -2 (k - 3) of time.
loaded = lmpchain.Chain(
    grains=3,
    material="steel",
    diameter=5e-3,
    gravity=0.0,
    top_load=50.0,
    top="wall",
    bottom="wall",
)
regular = orbits.chaos_of(scene.replace(chain=loaded, duration=0.1))
print("chaotic" if regular.chaotic else "regular")
picture_of_indices = regular.plot_gali()
