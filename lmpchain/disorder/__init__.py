"""Random chains, and averages over them."""

from ..util.lazy import attributes

__all__ = ["Ensemble", "at_the_end", "disordered", "ensemble", "factors", "realisation"]
__getattr__ = attributes(
    __name__, names={"averages": "Ensemble at_the_end ensemble", "draws": "disordered factors realisation"}
)
