"""Theory of the linear and continuous limits, in the paper's dimensionless variables.

Each function names its equation and the misprints of the paper. The exponent delta of the contact
force is one number, 1 or more, by default 3/2 as for Hertz contacts; ``xi = 1 - 1/delta``,
``eta = 1 + 1/delta`` and ``nu = 1/(1 + delta)``. Contact n has ``kappa_n = n^xi``, and grain n is
at the depth ``h = n - 1/2``. Array arguments broadcast.
"""

from ..util.lazy import attributes, listed

__all__ = [
    "bands",
    "bessel",
    "collision",
    "continuum",
    "dimer_soliton",
    "dyson",
    "front",
    "modes",
    "restitution",
    "scattering",
    "shock",
    "soliton",
    "steady",
]
__getattr__ = attributes(__name__, __all__)
__dir__ = listed(__name__)
