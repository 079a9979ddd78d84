"""Engines against a reference solution: errors, and speed against accuracy."""
