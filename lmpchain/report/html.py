"""Self-contained pages with a live figure; their security policy allows only its script."""

from __future__ import annotations

import base64
import hashlib
from typing import Any

from markupsafe import Markup

from ..util.templates import render


def render_live(template: str, numbers: dict[str, Any], **values: Any) -> str:
    """Render the template of a page with a live figure.

    Parameters
    ----------
    template : str
        Name of a template of the package.
    numbers : dict
        Numbers of the figure, from `live.figure_numbers`.
    **values
        Other values that the template uses.

    Returns
    -------
    str
    """
    script = render("live.js")
    # The security policy contains the hash of the script, so that no other script runs.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return render(template, live=numbers, script=Markup(script), digest=digest, **values)
