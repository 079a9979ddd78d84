"""Compiled loops; each is recompiled when its module, or a module that it imports, changes."""
