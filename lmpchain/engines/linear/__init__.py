"""Engines for the linearised chain, Eq. (3), and for the homogeneous and continuous ones."""
