"""Measured laws for the limits of methods and theories, which only the maps use."""
