"""Shared tools: arrays, input validation, files, tables, templates, MPI, compilation, plotting."""
