"""Compiled loops; each is compiled anew when its module, or one that it imports, changes."""
