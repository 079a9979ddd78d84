"""
An echo, and which way pulses go
================================

The power through a grain is positive in waves that go down and negative in waves that go up. Its
sign tells the echo of a heavy grain from the pulse that went out.
"""

import lmpchain
from lmpchain.measure import echo

chain = lmpchain.Chain(
    grains=60,
    material="steel",
    diameter=5e-3,
    gravity=0.0,
    bottom="wall",
    impurity=[{"grain": 40, "diameter": 8e-3}],
)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=0.1), duration=1e-3, samples=2001
)
found = echo.find(lmpchain.simulate(scene, tolerance=1e-8), grain=20, reflector=40)
print(f"back after {1e6 * found.seconds:.3f} us ± {1e6 * found.error:.1g} us")
print(f"with {found.share:.4f} ± {found.share_error:.1g} of the energy")
picture = found.plot()
