"""Scenes: the excitation of a chain, its recording, scene files, and the light cone."""

from ..util.lazy import attributes, listed

__all__ = [
    "Displacement",
    "Drive",
    "Excitation",
    "Force",
    "Impulse",
    "Packet",
    "Profile",
    "Recording",
    "Riemann",
    "Scene",
]
__getattr__ = attributes(
    __name__,
    names={
        "base": "Excitation",
        "excitation": "Displacement Drive Force Impulse Packet Profile Riemann",
        "recording": "Recording",
        "scene": "Scene",
    },
)
__dir__ = listed(__name__)
