"""Compiled loops. A module here is compiled anew where it, or one beside it that it imports, has changed."""
