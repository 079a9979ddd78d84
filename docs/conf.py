"""Sphinx configuration: hand-written pages in Markdown, the API from the docstrings, the gallery
from scripts.
"""

import sys
import warnings
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import sphinx.ext.autosummary
from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # for what Sphinx keeps by name, as equations
from gallery_pictures import describe_thumbnails  # noqa: E402

project = "lmpchain"
author = "the lmpchain developers"
version = release = installed_version("lmpchain")
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "sphinxarg.ext",
    "sphinxcontrib.bibtex",
    "equations",
    "live_figures",
]
exclude_patterns = [
    "build",
    "gallery",
    "**/*.ipynb",
    "**/sg_execution_times.rst",
    "sg_execution_times.rst",
]
templates_path = ["_templates"]

html_theme = "furo"
html_title = f"lmpchain {version}"
html_show_sourcelink = False
html_show_copyright = False
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_js_files = ["live_figures.js"]
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
myst_dmath_double_inline = True
html_math_renderer = "mathml"
bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"
myst_links_external_new_tab = False
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # s
nb_merge_streams = True

smartquotes_action = "qe"  # quotes and three dots; the two dashes of an option stay two
default_role = "py:obj"  # what docstrings put between single backquotes
autosummary_generate = True
# names of files that would differ by case only are one file on macOS and Windows
autosummary_filename_map = {
    "lmpchain.averages": "lmpchain.averages-function",
    "lmpchain.theory.bessel": "lmpchain.theory.bessel-module",
    "lmpchain.theory.continuum": "lmpchain.theory.continuum-module",
    "lmpchain.theory.modes": "lmpchain.theory.modes-module",
}
# a summary ends with its sentence, not within it
sphinx.ext.autosummary.WELL_KNOWN_ABBREVIATIONS += ("Eq.", "Eqs.", "Fig.", "Phys.")
autodoc_default_options = {
    "members": True,
    "member-order": "bysource",
    "exclude-members": "model_config",  # of Pydantic, and no word about the class
}
autodoc_typehints = "none"  # numpydoc's sections name the types
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# pages say what a warning says and by which command they were made, not in which folders
warnings.formatwarning = lambda message, category, *_: f"{category.__name__}: {message}\n"
sys.argv = ["sphinx-build", "docs", "docs/build"]

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "measurements",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("gallery_pictures.scraper",),
    "capture_repr": (),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "min_reported_time": 1e9,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
}


def leave_out(app: Sphinx, what: str, name: str, member: Any, skip: bool, options: Any) -> bool:
    """Leave out the fields of a named tuple, of which Python says their number alone."""
    return skip or str(getattr(member, "__doc__", "")).startswith("Alias for field number")


def setup(app: Sphinx) -> None:
    """Tell Sphinx what the reference leaves out, and how the gallery is described."""
    app.connect("autodoc-skip-member", leave_out)
    app.connect("doctree-resolved", describe_thumbnails)
