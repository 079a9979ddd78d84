"""The pictures of a gallery script: every figure or axes that a name of the script stands for,
once; and the live figure of what its name `live` holds.
"""

import sys
from pathlib import Path
from typing import Any

import live_figures
from docutils import nodes
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sphinx.application import Sphinx
from sphinx_gallery.scrapers import figure_rst

import lmpchain
from lmpchain.util.compilation import announce_nothing

announce_nothing()


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
    # else they are kept from script to script, and matplotlib warns of that
    pyplot.close("all")
    return figure_rst(shown, conf["src_dir"], title_of(names)) + _live(names, conf)


def describe_thumbnails(app: Sphinx, document: nodes.document, page: str) -> None:
    """Give the thumbnails of the gallery the titles of their scripts as text."""
    if page == "measurements/index":
        for image in document.findall(nodes.image):
            link = image.next_node(nodes.reference, ascend=True)
            image["alt"] = link.astext() if link else ""


def title_of(names: dict[str, Any]) -> str:
    """Return the title of a gallery script, which is the text in place of its pictures."""
    return Path(names["src_file"]).read_text(encoding="utf-8").splitlines()[1]


def _live(names: dict[str, Any], conf: dict[str, Any]) -> str:
    """Write the live figure of a script, once, and return what shows it."""
    source = names["example_globals"].pop("live", None)
    if source is None:
        return ""
    script = Path(names["src_file"])
    folder = Path(conf["src_dir"]) / "measurements" / "live"
    folder.mkdir(parents=True, exist_ok=True)
    # a figure names the command that wrote it, not the folder in which the pages were built
    sys.argv = [script.name]
    lmpchain.explore(source, folder / f"{script.stem}.html")
    element = live_figures.frame(script.stem, f"{title_of(names)}: live figure", "../")
    return f"\n\n.. raw:: html\n\n    {element}\n\n"
