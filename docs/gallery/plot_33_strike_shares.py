"""
How much of a strike solitary waves carry away
==============================================

By the exponent of the contact force: chain and duration are chosen by the speed of the exact wave.
"""

import numpy as np

import lmpchain

found = lmpchain.strike_shares(np.array([1.1, 1.2, 1.3, 1.5, 1.75, 2.0, 2.5, 3.0]))
for exponent, share, error in zip(found.exponent, found.share, found.share_error, strict=True):
    print(f"{exponent:.2f}: {share:.9f} ± {error:.1g}")
picture = found.plot()
