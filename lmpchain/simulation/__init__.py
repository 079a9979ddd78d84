"""Simulation of scenes: engine selection, runs, run folders and checkpoints."""
