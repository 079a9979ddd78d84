"""The pictures of a gallery script: every figure that a name of the script stands for, once."""

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


def scraper(block: Any, names: dict[str, Any], conf: dict[str, Any]) -> str:
    """Save the figures that are new since the block before, and return what shows them."""
    seen = names["example_globals"].setdefault("__pictures__", [])
    shown = []
    for picture in list(names["example_globals"].values()):
        if isinstance(picture, Figure) and not any(picture is other for other in seen):
            seen.append(picture)
            path = next(names["image_path_iterator"])
            picture.savefig(path, dpi=110)
            shown.append(path)
    return figure_rst(shown, conf["src_dir"])
