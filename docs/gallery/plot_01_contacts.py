"""
Contact forces, openings, wall force, a sensor in a grain
=========================================================

A steel chain between walls, loaded and struck, as in an experiment.
"""

import lmpchain
from lmpchain.measure import contact

ends = {"top": "wall", "bottom": "wall"}
chain = lmpchain.Chain(grains=30, material="steel", diameter=5e-3, gravity=0, top_load=0.5, **ends)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=0.1), duration=450e-6, samples=2251
)
t = lmpchain.simulate(scene, tolerance=1e-9)

history = contact.contacts(t, [1, 2, 10, 20])  # overlap, force and closing speed
picture = history.plot()

# %%
# Openings and closings are located between samples.
first = history.events()[0]
print(
    f"contact {first.contact} {'opens' if first.opens else 'closes'} at {1e6 * first.time:.2f} us"
)

# %%
# The force on the floor, and what a piezo inside grain 20 reads: the mean of the forces on both
# sides of it.
print(f"largest force on the floor {contact.wall_force(t).max():.1f} N")
signal = contact.sensor(t, 20)
picture_of_sensor = signal.plot()
