"""The engines, by name."""

from __future__ import annotations

from importlib import import_module
from inspect import signature
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .base import Engine

if TYPE_CHECKING:
    from .lammps.engine import Lammps as Lammps
    from .linear.closed_form import Bessel as Bessel
    from .linear.closed_form import Continuum as Continuum
    from .linear.engine import Chebyshev as Chebyshev
    from .linear.engine import Modes as Modes
    from .native import Native as Native

_WHERE = {
    "lammps": ("lammps.engine", "Lammps"),
    "native": ("native", "Native"),
    "modes": ("linear.engine", "Modes"),
    "chebyshev": ("linear.engine", "Chebyshev"),
    "bessel": ("linear.closed_form", "Bessel"),
    "continuum": ("linear.closed_form", "Continuum"),
}
ON_REQUEST = ("lammps",)  # done by "auto" only where no other engine can
LADDER = tuple(name for name in _WHERE if name not in ON_REQUEST)


def names() -> tuple[str, ...]:
    """Return the names that `simulate(engine=...)` knows.

    Examples
    --------
    >>> names()
    ('lammps', 'native', 'modes', 'chebyshev', 'bessel', 'continuum')
    """
    return tuple(_WHERE)


def get(engine: str | Engine, **options: Any) -> Engine:
    """Return the engine of this name with these options; "auto" with options takes the native one, whose they are.

    Raises
    ------
    InputError
        If there is no such engine or an option is wrong.
    """
    if isinstance(engine, Engine):
        if options:
            raise InputError([(key, "belongs to the engine: give it to its constructor") for key in options])
        return engine
    if engine == "auto" and not options:
        from ..simulation.selection import Auto

        return Auto()
    name = "native" if engine == "auto" else engine
    if name not in _WHERE:
        raise InputError([("engine", f"must be auto | {' | '.join(_WHERE)} (got {engine!r})")])
    module, cls = _WHERE[name]
    made: type[Engine] = getattr(import_module(f".{module}", __name__), cls)
    known = list(signature(made).parameters) if options else []
    if unknown := [key for key in options if key not in known]:
        raise InputError([(key, f"the engine {name} has no such option; it has {', '.join(known)}") for key in unknown])
    return made(**options)


def __getattr__(name: str) -> Any:
    for module, cls in _WHERE.values():
        if cls == name:
            return getattr(import_module(f".{module}", __name__), cls)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
