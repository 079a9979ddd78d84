"""The chain at rest: materials, contact law, grains, walls and patterns of grains."""

from ..util.lazy import attributes, listed

__all__ = ["Chain", "Contacts", "Damping", "Impurity", "Law", "Material", "laws", "patterns"]
__getattr__ = attributes(
    __name__,
    ["laws", "patterns"],
    {
        "chain": "Chain",
        "contact_law": "Contacts",
        "damping": "Damping",
        "law": "Law",
        "materials": "Impurity Material",
    },
)
__dir__ = listed(__name__)
