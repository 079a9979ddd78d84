"""Text from the templates: LAMMPS input and pages."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).parent
_FOLDERS = [_PACKAGE / "templates", _PACKAGE.parent / "templates"]  # in a wheel, in a source tree


def render(name: str, **values: Any) -> str:
    """Fill in a template; a value that it names and does not get is an error. HTML is escaped.

    Numbers go through the filter `exact` where every digit counts.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_FOLDERS),
        undefined=StrictUndefined,
        autoescape=name.endswith(".html"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["exact"] = lambda value: repr(float(value))
    return environment.get_template(name).render(version=version("lmpchain"), **values)
