"""Periodic orbits of granular chains: nonlinear normal modes, breathers, families and stability."""

from ..util.lazy import attributes, listed

__all__ = [
    "Chaos",
    "Event",
    "Family",
    "Orbit",
    "breather",
    "chaos_of",
    "find",
    "follow",
    "linear_mode",
    "mode_family",
    "normal_mode",
    "switch",
]
__getattr__ = attributes(
    __name__,
    names={
        "chaos": "Chaos chaos_of",
        "orbit": "Orbit",
        "search": "find linear_mode switch",
        "modes": "breather mode_family normal_mode",
        "continuation": "follow",
        "family": "Event Family",
    },
)
__dir__ = listed(__name__)
