"""Maps of the limits of methods; in each module `measure` returns numbers, and `draw` a figure."""
