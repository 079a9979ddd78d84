"""Engines for linearised chains, Eq. (3), and for homogeneous and continuous limits."""
