"""Integrators of Eq. (1): kick-drift splittings, DOP853 and Gear, and their compiled loops."""
