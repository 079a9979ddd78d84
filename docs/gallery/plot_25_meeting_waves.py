"""
Live: solitary waves that meet
==============================

Both ends of a chain are struck at once. Without a load each strike becomes a solitary wave, some
five grains wide; the two pass through each other and leave small waves behind. Under a load they
become packets of sound.
"""

import numpy as np

import lmpchain

velocity = np.zeros(60)
velocity[0] = 0.3
velocity[-1] = -0.2
chain = lmpchain.Chain(grains=60, diameter=1e-3, gravity=0.0, top="free", bottom="wall")
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Profile(velocity=velocity), duration=1e-4, samples=241
)
picture = lmpchain.simulate(scene, "native", 1e-6).plot()

# %%
# The same as a live figure, by ``lmpchain.explore(live, "meeting.html")``:
live = {"scene": scene, "over": {"chain.top_load": [0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0]}}
