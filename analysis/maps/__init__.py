"""Where methods fail, one map a module: `measure(quick)` returns
numbers, `draw(numbers)` a figure.
"""
