"""
The front: when it passes, how high, how wide
=============================================

A weak strike on a column: the front fades as a power of depth.
"""

import lmpchain
from lmpchain.measure import front

chain = lmpchain.Chain(grains=300, diameter=1e-3)
duration = 200 * chain.time_scale
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-9), duration=duration, samples=1601
)
t = lmpchain.simulate(scene, "chebyshev", 1e-5)

# .time .amplitude .width of every grain, with errors, but those near the wall
found = front.track(t).between(1, 280)
picture = found.plot()
# the law of great depth, through the deepest point
h, amplitude, *_ = found.against_depth("amplitude")
law_of_height = amplitude[-1] * (h / h[-1]) ** (-4 / 15)
picture.plot(h, law_of_height, "--", color="0.4", label="law of great depth, $h^{-4/15}$")
picture.legend()

# %%
# Its width, which dispersion spreads.
picture_of_width = found.plot(quantity="width")
h, width, *_ = found.against_depth("width")
law_of_width = width[-1] * (h / h[-1]) ** (1 / 6)
picture_of_width.plot(h, law_of_width, "--", color="0.4", label="law of great depth, $h^{1/6}$")
picture_of_width.legend()

# %%
# The local exponent of the amplitude tends to -4/15 = -0.267.
picture_of_exponent = front.exponent(found).plot()
picture_of_exponent.axhline(-4 / 15, ls="--", color="0.4", label="law of great depth, $-4/15$")
picture_of_exponent.legend()

# %%
# The asymptotic law with its correction at finite depth.
law = front.asymptotic(found.between(20, 250), "amplitude", 1.5)
print(f"exponent {law.exponent:.4f} +- {law.error[0]:.4f}; -4/15 = {-4 / 15:.4f}")
picture_of_law = law.plot()
