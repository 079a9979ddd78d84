"""The chain at rest: materials, contact law, grains, walls and patterns of grains."""

from ..util.lazy import attributes, listed

__all__ = ["Chain", "Contacts", "Damping", "Impurity", "Law", "Material", "laws", "patterns"]
__getattr__ = attributes(
    __name__,
    ["laws", "patterns"],
    {
        "chain": "Chain",
        "contacts": "Contacts",
        "damping": "Damping",
        "impurities": "Impurity",
        "law": "Law",
        "materials": "Material",
    },
)
__dir__ = listed(__name__)
