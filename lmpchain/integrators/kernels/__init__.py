"""Compiled loops; one is compiled anew when its module, or one beside it that it imports, changes."""
