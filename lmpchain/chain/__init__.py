"""The chain at rest: materials, the force law of contacts, grains and walls, and ready-made patterns of grains."""

from ..util.lazy import attributes

__all__ = ["Chain", "Contacts", "Impurity", "Material", "patterns"]
__getattr__ = attributes(
    __name__,
    ["patterns"],
    {"chain": "Chain", "contacts": "Contacts", "impurities": "Impurity", "materials": "Material"},
)
