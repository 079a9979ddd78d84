"""
Time of flight between two sensors
==================================

As an experiment does it: from the peak at one sensor to the peak at the other, with its
error.
"""

import lmpchain
from lmpchain.measure import flight, spectrum

ends = {"top": "wall", "bottom": "wall"}
chain = lmpchain.Chain(grains=30, material="steel", diameter=5e-3, gravity=0, top_load=0.5, **ends)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=0.1), duration=300e-6, samples=1201
)
t = lmpchain.simulate(scene, tolerance=1e-9)

along = flight.time_of_flight(t, 5, 25)
print(f"{along.speed:.1f} m/s over {1e3 * along.distance:.0f} mm")

# %%
# The motion over time and depth; the line is a long weak wave, which is slower than this pulse.
picture = spectrum.space_time(t, law=True)
