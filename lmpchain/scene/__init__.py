"""What happens: how a chain is set in motion, what is recorded, scene files, and how far a wave can have come."""

from ..util.lazy import attributes

__all__ = ["Displacement", "Drive", "Excitation", "Impulse", "Profile", "Recording", "Scene"]
__getattr__ = attributes(
    __name__,
    names={
        "base": "Excitation",
        "excitation": "Displacement Drive Impulse Profile",
        "recording": "Recording",
        "scene": "Scene",
    },
)
