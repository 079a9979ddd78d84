"""Text from Jinja2 templates, the package's or the user's: LAMMPS input and HTML pages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import FileSystemLoader, StrictUndefined, TemplateNotFound, TemplateSyntaxError
from jinja2.meta import find_undeclared_variables
from jinja2.runtime import Macro
from jinja2.sandbox import ImmutableSandboxedEnvironment, SecurityError

from ..errors import InputError, short, shown
from .memory import memory_limit

LARGEST_TEXT = 2**28  # Largest memory that a user's template may use, bytes.
_PACKAGE = Path(__file__).parent.parent
_FOLDERS = [_PACKAGE / "templates", _PACKAGE.parent / "templates"]  # In a wheel; in a source tree.


class _Sandbox(ImmutableSandboxedEnvironment):
    """Sandbox for templates that read their values and call only `range` and their own macros."""

    intercepted_binops = frozenset(["**"])

    def __init__(self, closed: tuple[type, ...] = (), **options: Any):
        self._closed_types = closed
        super().__init__(
            loader=FileSystemLoader(_FOLDERS),
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
            **options,
        )
        self.filters["exact"] = lambda value: repr(float(value))
        # Templates see only the globals that they need.
        self.globals = {"range": self.globals["range"]}

    def call_binop(self, context: Any, operator: str, left: Any, right: Any) -> Any:
        # A power of whole numbers may have any number of digits, and cannot be interrupted.
        power = float(left) ** float(right)
        whole = isinstance(left, int) and power.is_integer() and abs(power) < 2**53
        return int(power) if whole else power

    def is_safe_callable(self, obj: Any) -> bool:
        return isinstance(obj, Macro) or obj is self.globals["range"]

    def is_safe_attribute(self, obj: Any, attr: str, value: Any) -> bool:
        return not isinstance(obj, self._closed_types) and super().is_safe_attribute(
            obj, attr, value
        )


def render(name: str, closed: tuple[type, ...] = (), **values: Any) -> str:
    """Fill in a template of the package, with HTML escapes; raise an error for a missing value.

    The filter `exact` writes a number with all its digits. Templates cannot read attributes of
    objects of the types `closed`.
    """
    return "".join(render_pieces(name, closed, **values))


def render_pieces(name: str, closed: tuple[type, ...] = (), **values: Any) -> Iterator[str]:
    """Fill in a template of the package in pieces, for long text; see `render`."""
    template = _environment(closed, name.endswith(".html")).get_template(name)
    return template.generate(version=version("lmpchain"), **values)


@cache
def _environment(closed: tuple[type, ...], autoescape: bool) -> _Sandbox:
    """Return the environment that stores the compiled templates of the package."""
    return _Sandbox(closed, autoescape=autoescape)


def render_text(text: str, key: str, closed: tuple[type, ...] = (), **values: Any) -> str:
    """Fill in a template of the user, which may include templates of the package.

    The template cannot read attributes of objects of the types `closed`.

    Raises
    ------
    InputError
        If the template names an unknown value, is invalid or does something that is not allowed.
        The message begins with `key`.
    """
    environment = _Sandbox(closed)
    values = {"version": version("lmpchain"), **values}
    try:
        with memory_limit(LARGEST_TEXT):
            variables = find_undeclared_variables(environment.parse(text))
            unknown = variables - values.keys() - environment.globals.keys()
            if not unknown:
                return environment.from_string(text).render(values)
    except TemplateSyntaxError as error:
        raise InputError.at(
            key, f"line {error.lineno} is not valid Jinja2: {error.message}"
        ) from None
    except TemplateNotFound as error:
        # Example scenes are not decks.
        names = ", ".join(environment.list_templates(filter_func=lambda name: "/" not in name))
        raise InputError.at(key, f"cannot include {shown(error.name)}; there are {names}") from None
    except SecurityError:
        cure = "it may only read the values that it is given, and call range and its own macros"
        raise InputError.at(key, f"uses something that templates cannot access: {cure}") from None
    except MemoryError:
        limit = f"needs more than {LARGEST_TEXT >> 20} MB of memory"
        raise InputError.at(key, f"{limit}: make its texts and lists shorter") from None
    except Exception as error:
        # Expressions of a template may raise any error.
        reason = str(error) or type(error).__name__
        raise InputError.at(key, f"cannot be filled in: {short(reason)}") from None
    cure = f"there are {', '.join(sorted(values))}"
    raise InputError(
        (key, f"there is no placeholder {shown(name)}; {cure}") for name in sorted(unknown)
    )
