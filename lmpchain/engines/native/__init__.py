"""Eq. (1) in displacements, integrated by compiled loops."""
