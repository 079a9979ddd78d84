"""Contact laws and ground laws of the literature, each one formula.

A contact law is a force in N as a function of the overlap o in m. Parameters are one number, or one
for each contact between grains. Where a contact constant k has a default of None, it follows from
the grains of the chain.
"""

from __future__ import annotations

from typing import Any

from .law import Law


def _law(formula: str, **parameters: Any) -> Law:
    return Law(formula, **{name: each for name, each in parameters.items() if each is not None})


def hertz(k: Any = None) -> Law:
    """Return Hertz's law, k o^1.5 of a closed contact (H. Hertz, J. reine angew. Math. 92, 156).

    Examples
    --------
    >>> hertz(k=1e9).force(1e-6).round(6)
    np.float64(1.0)
    """
    return _law("k*max(o, 0)**1.5", k=k)


def power(exponent: Any, k: Any = None) -> Law:
    """Return k o^exponent of a closed contact, one exponent or one for each contact.

    Exponents below 1 soften, as in woodpile and origami chains (arXiv:2210.11690).
    """
    return _law("k*max(o, 0)**p", p=exponent, k=k)


def fput(k: Any, alpha: Any = 0.0, beta: Any = 0.0) -> Law:
    """Return the force k o + alpha o^2 + beta o^3 of Fermi, Pasta, Ulam and Tsingou (1955).

    A bond that is stretched (o < 0) pulls. k is in N/m, alpha in N/m2, beta in N/m3.
    """
    return _law("k*o + alpha*o**2 + beta*o**3", k=k, alpha=alpha, beta=beta)


def toda(k: Any, b: Any) -> Law:
    """Return the force k (exp(b o) - 1) of Toda's lattice (M. Toda, J. Phys. Soc. Jpn. 22, 431).

    k is in N, b in 1/m.
    """
    return _law("k*(exp(b*o) - 1)", k=k, b=b)


def bilinear(k: Any, ratio: Any) -> Law:
    """Return springs k that are softer or stiffer by a ratio when stretched (arXiv:2502.08726)."""
    return _law("k*max(o, 0) + ratio*k*min(o, 0)", k=k, ratio=ratio)


def dmt(pull: Any, k: Any = None) -> Law:
    """Return Hertz's law less a constant pull, N (Derjaguin, Muller and Toporov 1975)."""
    return _law("k*max(o, 0)**1.5 - pull", pull=pull, k=k)


def bistable(k: Any, near: Any, far: Any) -> Law:
    """Return the force k o (1 - o/near) (1 - o/far), 0 at three overlaps (arXiv:2301.09149).

    At rest without load a contact is at o = 0.
    """
    return _law("k*o*(1 - o/near)*(1 - o/far)", k=k, near=near, far=far)
