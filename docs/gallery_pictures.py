"""The pictures of a gallery script: every figure or axes that a name of the script stands for,
once.
"""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def scraper(block: Any, names: dict[str, Any], conf: dict[str, Any]) -> str:
    """Save the figures that are new since the block before, and return what shows them."""
    seen = names["example_globals"].setdefault("__pictures__", [])
    shown = []
    for name, value in list(names["example_globals"].items()):
        if (
            name.startswith("picture")
            and isinstance(value, Figure | Axes)
            and value.figure not in seen
        ):
            seen.append(value.figure)
            shown.append(next(names["image_path_iterator"]))
            value.figure.savefig(shown[-1], dpi=110)
    return figure_rst(shown, conf["src_dir"])
