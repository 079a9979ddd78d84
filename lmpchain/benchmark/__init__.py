"""Engines beside the truth: the reference solution, errors, and speed against accuracy."""
