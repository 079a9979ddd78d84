"""The engines by name."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from inspect import signature
from typing import TYPE_CHECKING, Any, Literal

from ..errors import InputError, did_you_mean, either, not_among
from ..scene.scene import Scene
from ..util.lazy import listed
from .base import Engine

if TYPE_CHECKING:
    from .lammps.engine import Lammps as Lammps
    from .linear.closed_form import Bessel as Bessel
    from .linear.closed_form import Continuum as Continuum
    from .linear.engine import Chebyshev as Chebyshev
    from .linear.engine import Modes as Modes
    from .native import Native as Native

__dir__ = listed(__name__)

REGISTRY = {  # Module and class of each engine by name.
    "lammps": ("lammps.engine", "Lammps"),
    "native": ("native", "Native"),
    "modes": ("linear.engine", "Modes"),
    "chebyshev": ("linear.engine", "Chebyshev"),
    "bessel": ("linear.closed_form", "Bessel"),
    "continuum": ("linear.closed_form", "Continuum"),
}
__all__ = ["Engine", "automatic", "get", "names", *(cls for _, cls in REGISTRY.values())]
DEFAULT = "native"  # A single engine in place of "auto".
# Arguments of `simulate` that every engine shares.
ARGUMENTS = ("engine", "tolerance", "on_miss", "progress", "folder", "max_wall")


def names() -> tuple[str, ...]:
    """Return the names of the engines.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> names()
    ('lammps', 'native', 'modes', 'chebyshev', 'bessel', 'continuum')
    """
    return tuple(REGISTRY)


def automatic(when: Literal["cheapest", "last"] = "cheapest") -> tuple[str, ...]:
    """Return the names of the engines that "auto" chooses from (see `Engine.auto`)."""
    return tuple(name for name in REGISTRY if class_of(name).auto == when)


def get(engine: str | Engine, **options: Any) -> Engine:
    """Return the engine of this name with these options.

    Raises
    ------
    InputError
        If there is no such engine, or if an option is wrong.
    """
    if not isinstance(engine, str) and isinstance(engine, Engine):
        if options:
            raise InputError(
                [(key, "belongs to the engine: give it to its constructor") for key in options]
            )
        return engine
    # A list has no hash.
    if not isinstance(engine, str) or engine not in REGISTRY:
        raise InputError.at("engine", not_among(engine, REGISTRY))
    engine_class = _load(*REGISTRY[engine])
    # The constructor itself would report only the first wrong option.
    parameters = list(signature(engine_class).parameters) if options else []
    if unknown := [key for key in options if key not in parameters]:
        cure = (
            f"it has {', '.join(parameters)}" if parameters else "it has no options: leave it out"
        )
        no = f"the engine {engine} has no such option"
        # An argument that all engines share may also be misspelt.
        known = (*parameters, *ARGUMENTS)
        raise InputError([(key, f"{no}{did_you_mean(key, known)}; {cure}") for key in unknown])
    return engine_class(**options)


@cache
def plain(name: str) -> Engine:
    """Return the engine of this name without options, always the same object."""
    return get(name)


def class_of(name: str) -> type[Engine]:
    """Return the class of an engine, for its attributes; `Engine` for an unknown name."""
    return _load(*REGISTRY[name]) if name in REGISTRY else Engine


def obstacles(engine: Engine, scene: Scene) -> list[tuple[str, str]]:
    """Return the reasons why an engine cannot solve a scene or its quantities, as (key, reason)."""
    reasons = engine.refuses(engine.part(scene))
    if scene.chain.damped and not engine.dissipates:
        cure = f"use {_those_that(lambda engine: engine.dissipates)}"
        fault = f"{engine.name} conserves energy: leave damping out, or {cure}"
        reasons = [*reasons, ("chain.damping", fault)]
    if scene.chain.ground is not None and not engine.knows_ground:
        cure = f"use {_those_that(lambda engine: engine.knows_ground)}"
        fault = f"{engine.name} does not support a force from the ground: leave it out, or {cure}"
        reasons = [*reasons, ("chain.ground", fault)]
    # Recorded quantities are computed from accelerations, which only the equations of grains
    # provide.
    if scene.quantities and not engine.moves_grains:
        why = f"{engine.name} does not compute accelerations of grains, which quantities require"
        cure = f"use {_those_that(lambda engine: engine.moves_grains)}"
        reasons = [*reasons, ("quantities", f"{why}; {cure}")]
    return reasons


def brief(engine: str, refusal: str) -> str:
    """Return the first reason for a refusal, without the name of the engine and the remedy."""
    return re.split("; |: ", refusal.removeprefix(f"{engine} "))[0]


def _those_that(do: Callable[[Engine], bool]) -> str:
    """Return in words the engines of "auto" that have a given property."""
    return either(name for name in (*automatic(), *automatic("last")) if do(plain(name)))


@cache
def _load(module: str, name: str) -> type[Engine]:
    return getattr(import_module(f".{module}", __name__), name)


def __getattr__(name: str) -> Any:
    for module, cls in REGISTRY.values():
        if cls == name:
            return _load(module, cls)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
