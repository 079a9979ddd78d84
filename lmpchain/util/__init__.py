"""Shared tools: arrays, validation, files, tables, templates, MPI, compilation, plotting."""
