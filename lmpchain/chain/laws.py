"""Contact and ground laws of the literature, each written as a `Law`.

Without k, a contact law uses the contact constants of the chain. A ground law always needs k.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .law import Law


def _law(formula: str, k: Any, **parameters: Any) -> Law:
    return Law(formula, **({} if k is None else {"k": k}), **parameters)


def hertz(k: Any = None) -> Law:
    """Return ``k o^1.5`` of spheres that touch (H. Hertz, J. reine angew. Math. 92, 156, 1882).

    Parameters
    ----------
    k : float or (N-1,) array, optional
        Contact constant, in N/m^1.5; by default it follows from the grains of the chain.

    Returns
    -------
    Law
    """
    return _law("k*max(o, 0)**1.5", k)


def power(exponent: Any, k: Any = None) -> Law:
    """Return ``k o^exponent`` of a closed contact, with one exponent or one for each contact.

    Nesterenko, Dynamics of Heterogeneous Materials (Springer, 2001), section 1.11. Herbold and
    Nesterenko, Phys. Rev. Lett. 110, 144101 (2013), consider exponents below 1.

    Parameters
    ----------
    exponent : float or (N-1,) array
        Power of the overlap.
    k : float or (N-1,) array, optional
        Contact constant, in N/m^exponent; by default it follows from the grains of the chain.

    Returns
    -------
    Law

    Examples
    --------
    >>> power(0.6)
    Law('k*max(o, 0)**p', p=0.6)
    """
    return _law("k*max(o, 0)**p", k, p=exponent)


def fput(alpha: Any = 0.0, beta: Any = 0.0, k: Any = None) -> Law:
    """Return ``k o - alpha o^2 + beta o^3``, the spring of Fermi, Pasta, Ulam and Tsingou.

    The sign of alpha is that of the original report (Los Alamos report LA-1940, 1955), where alpha
    multiplies the square of the extension -o.

    Parameters
    ----------
    alpha, beta : float or (N-1,) array, optional
        Coefficient of the quadratic force, N/m2; coefficient of the cubic force, N/m3.
    k : float or (N-1,) array, optional
        Contact constant, in N/m; by default it follows from the grains of the chain.

    Returns
    -------
    Law
    """
    return _law("k*o - alpha*o**2 + beta*o**3", k, alpha=alpha, beta=beta)


def toda(b: Any, k: Any = None) -> Law:
    """Return ``k (exp(b o) - 1) / b`` (M. Toda, J. Phys. Soc. Japan 22, 431, 1967).

    Parameters
    ----------
    b : float or (N-1,) array
        Inverse length of the exponential, 1/m.
    k : float or (N-1,) array, optional
        Contact constant, in N/m; by default it follows from the grains of the chain.

    Returns
    -------
    Law
    """
    return _law("k*(exp(b*o) - 1)/b", k, b=b)


def bilinear(tension: Any, k: Any = None) -> Law:
    """Return a spring with stiffness k in compression and ``tension k`` in tension.

    Shaw and Holmes, J. Sound Vib. 90, 129 (1983).

    Parameters
    ----------
    tension : float or (N-1,) array
        Ratio of the stiffness in tension to the stiffness in compression.
    k : float or (N-1,) array, optional
        Contact constant, in N/m; by default it follows from the grains of the chain.

    Returns
    -------
    Law

    Examples
    --------
    >>> bilinear(0.3, k=1e3).force([-1e-6, 1e-6]).tolist()
    [-0.0003, 0.001]
    """
    return _law("k*(max(o, 0) + tension*min(o, 0))", k, tension=tension)


def softening(length: Any, k: Any = None) -> Law:
    """Return ``k length tanh(o / length)``, whose force is bounded by ``k length``.

    Models of softening metamaterials use bounded contact forces. The energy has a closed form.

    Parameters
    ----------
    length : float or (N-1,) array
        Overlap at which the force saturates, m.
    k : float or (N-1,) array, optional
        Contact constant, in N/m; by default it follows from the grains of the chain.

    Returns
    -------
    Law
    """
    return _law("k*length*tanh(o/length)", k, length=length)


def dmt(pull: Any, reach: Any, k: Any = None) -> Law:
    """Return Hertz's force minus an adhesive pull that decreases to 0 over a given gap, m.

    Derjaguin, Muller and Toporov, J. Colloid Interface Sci. 53, 314 (1975). The pull of the
    original law ends abruptly. Here it decreases linearly over the reach, because no integration
    method keeps its order at a jump of the force.

    Parameters
    ----------
    pull : float or (N-1,) array
        Adhesive force, N.
    reach : float or (N-1,) array
        Gap in which the pull falls to 0, m.
    k : float or (N-1,) array, optional
        Contact constant, in N/m^1.5; by default it follows from the grains of the chain.

    Returns
    -------
    Law
    """
    formula = "k*max(o, 0)**1.5 - pull*min(1, max(0, 1 + o/reach))"
    return _law(formula, k, pull=pull, reach=reach)


def bistable(a: Any, b: Any, k: Any = None) -> Law:
    """Return ``k o (1 + o/a) (1 + o/b)``: at rest at o = 0, and stretched by the larger of a and b.

    Frazier and Kochmann, Adv. Mater. 29, 1605800 (2017).

    Parameters
    ----------
    a, b : float or (N-1,) array
        Stretches of the bond at which the force is 0 again, m.
    k : float or (N-1,) array, optional
        Contact constant, in N/m; by default it follows from the grains of the chain.

    Returns
    -------
    Law
    """
    return _law("k*o*(1 + o/a)*(1 + o/b)", k, a=a, b=b)


def klein_gordon(k: Any, beta: Any = 0.0) -> Law:
    """Return the ground law ``k u + beta u^3`` of a Klein-Gordon chain.

    Without beta the ground is a linear spring. arXiv:2112.02254 studies both in disordered chains.

    Parameters
    ----------
    k : float or (N,) array
        Stiffness, N/m.
    beta : float or (N,) array, optional
        Cubic coefficient, N/m3.

    Returns
    -------
    Law
    """
    return Law("k*u + beta*u**3", k=k, beta=beta)


def frenkel_kontorova(k: Any, period: Any) -> Law:
    """Return the ground law ``k sin(q u) / q``, ``q = 2 pi / period``, of a periodic potential.

    O. M. Braun and Y. S. Kivshar, The Frenkel-Kontorova Model (Springer, 2004).

    Parameters
    ----------
    k : float or (N,) array
        Stiffness at rest, N/m.
    period : float or (N,) array
        Period of the potential, m.

    Returns
    -------
    Law

    Examples
    --------
    >>> law = frenkel_kontorova(1e3, period=1e-6)
    >>> f"{law.stiffness(0.0):.6g} N/m, {law.stiffness(0.5e-6):.6g} N/m"
    '1000 N/m, -1000 N/m'
    """
    wavenumber = 2 * np.pi / np.asarray(period, float)
    return Law("k*sin(q*u)/q", k=k, q=wavenumber)


def mathieu(k: Any, depth: Any, frequency: Any) -> Law:
    """Return the ground law ``k (1 + depth cos(w t)) u``, a stiffness modulated in time.

    A single grain then follows Mathieu's equation (Digital Library of Mathematical Functions,
    chapter 28).

    Parameters
    ----------
    k : float or (N,) array
        Mean stiffness, N/m.
    depth : float or (N,) array
        Amplitude of the modulation divided by the mean stiffness.
    frequency : float or (N,) array
        Frequency of the modulation, w / 2 pi, Hz.

    Returns
    -------
    Law
    """
    w = 2 * np.pi * np.asarray(frequency, float)
    return Law("k*(1 + a*cos(w*t))*u", k=k, a=depth, w=w)
