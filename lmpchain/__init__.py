"""Waves in columns of Hertzian grains: LAMMPS, a native integrator and theory, side by side."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import disorder as disorder
    from . import engines as engines
    from . import measure as measure
    from . import patterns as patterns
    from . import theory as theory
    from .chain import Chain as Chain
    from .chain import Impurity as Impurity
    from .doctor import diagnose as diagnose
    from .errors import EngineUnavailable as EngineUnavailable
    from .errors import InputError as InputError
    from .errors import LmpchainError as LmpchainError
    from .errors import RunFailed as RunFailed
    from .errors import ToleranceNotMet as ToleranceNotMet
    from .excitation import Displacement as Displacement
    from .excitation import Drive as Drive
    from .excitation import Impulse as Impulse
    from .excitation import Profile as Profile
    from .materials import BRASS as BRASS
    from .materials import GLASS as GLASS
    from .materials import PTFE as PTFE
    from .materials import STEEL as STEEL
    from .materials import TUNGSTEN_CARBIDE as TUNGSTEN_CARBIDE
    from .materials import Material as Material
    from .planner import plan as plan
    from .runs.stopping import Stopped as Stopped
    from .scene import Scene as Scene
    from .simulation import resume as resume
    from .simulation import simulate as simulate
    from .sweeps.results import load_sweep as load_sweep
    from .sweeps.sweeping import sweep as sweep
    from .trajectory import Trajectory as Trajectory
    from .workprecision import work_precision as work_precision

_WHERE = {
    "chain": "Chain Impurity",
    "materials": "Material GLASS STEEL PTFE BRASS TUNGSTEN_CARBIDE",
    "excitation": "Impulse Displacement Profile Drive",
    "scene": "Scene",
    "simulation": "simulate resume",
    "planner": "plan",
    "runs.stopping": "Stopped",
    "sweeps.sweeping": "sweep",
    "sweeps.results": "load_sweep",
    "trajectory": "Trajectory",
    "workprecision": "work_precision",
    "doctor": "diagnose",
    "errors": "LmpchainError InputError ToleranceNotMet RunFailed EngineUnavailable",
}
_MODULE = {name: module for module, names in _WHERE.items() for name in names.split()}
_SUBMODULES = ("disorder", "engines", "measure", "patterns", "theory")
__all__ = [*_SUBMODULES, *_MODULE]


def __getattr__(name: str) -> Any:
    """Import public names when they are first used, so that none pays for what it does not use."""
    if name in _SUBMODULES:
        return import_module(f".{name}", __name__)
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULE[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
