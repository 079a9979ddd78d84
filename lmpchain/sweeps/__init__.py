"""Sweeps over many scenes."""
