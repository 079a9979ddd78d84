"""One self-contained page about a run: summary, live view, pictures, fits and provenance."""

from ..util.lazy import attributes, listed

__all__ = ["explore", "page", "write"]
__getattr__ = attributes(__name__, names={"document": "page write", "exploration": "explore"})
__dir__ = listed(__name__)
