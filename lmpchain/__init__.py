"""Waves in columns of Hertzian grains: LAMMPS, a native integrator and theory, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .util.lammps_import import load_mpi_before_lammps
from .util.lazy import attributes, listed

# Type checkers and editors read these lines, which never run.
if TYPE_CHECKING:
    from . import benchmark as benchmark
    from . import chain as chain
    from . import design as design
    from . import disorder as disorder
    from . import doctor as doctor
    from . import engines as engines
    from . import measure as measure
    from . import orbits as orbits
    from . import report as report
    from . import stability as stability
    from . import theory as theory
    from . import trajectory as trajectory
    from .benchmark.bench import work_precision as work_precision
    from .benchmark.own_run import check as check
    from .benchmark.own_run import check_deck as check_deck
    from .chain import laws as laws
    from .chain import patterns as patterns
    from .chain.chain import Chain as Chain
    from .chain.damping import Damping as Damping
    from .chain.law import Law as Law
    from .chain.materials import ALUMINIUM as ALUMINIUM
    from .chain.materials import BRASS as BRASS
    from .chain.materials import BRONZE as BRONZE
    from .chain.materials import GLASS as GLASS
    from .chain.materials import NYLON as NYLON
    from .chain.materials import POM as POM
    from .chain.materials import PTFE as PTFE
    from .chain.materials import RUBBER as RUBBER
    from .chain.materials import SODA_LIME_GLASS as SODA_LIME_GLASS
    from .chain.materials import STEEL as STEEL
    from .chain.materials import STEEL_302 as STEEL_302
    from .chain.materials import STEEL_440C as STEEL_440C
    from .chain.materials import TUNGSTEN_CARBIDE as TUNGSTEN_CARBIDE
    from .chain.materials import Impurity as Impurity
    from .chain.materials import Material as Material
    from .doctor import diagnose as diagnose
    from .errors import EngineUnavailable as EngineUnavailable
    from .errors import InputError as InputError
    from .errors import LmpchainError as LmpchainError
    from .errors import RunFailed as RunFailed
    from .errors import ToleranceNotMet as ToleranceNotMet
    from .report.exploration import explore as explore
    from .scene.excitation import Displacement as Displacement
    from .scene.excitation import Drive as Drive
    from .scene.excitation import Force as Force
    from .scene.excitation import Impulse as Impulse
    from .scene.excitation import Packet as Packet
    from .scene.excitation import Profile as Profile
    from .scene.excitation import Riemann as Riemann
    from .scene.scene import Scene as Scene
    from .simulation.api import resume as resume
    from .simulation.api import simulate as simulate
    from .simulation.many import simulate_many as simulate_many
    from .simulation.planner import plan as plan
    from .simulation.run_folder import Stopped as Stopped
    from .simulation.time_averages import Averages as Averages
    from .simulation.time_averages import averages as averages
    from .sweeps.dispersion import dispersion as dispersion
    from .sweeps.results import load_sweep as load_sweep
    from .sweeps.run import sweep as sweep
    from .sweeps.strike_shares import strike_shares as strike_shares
    from .trajectory.trajectory import Trajectory as Trajectory
    from .util.version import __version__ as __version__

# Modules are imported at the first use of a name, because importing all of them takes a second and
# a command needs only a few.
_MODULES = {
    "chain.chain": "Chain",
    "chain.damping": "Damping",
    "chain.law": "Law",
    "chain.materials": "Impurity Material GLASS SODA_LIME_GLASS STEEL STEEL_302 STEEL_440C"
    " ALUMINIUM BRASS BRONZE TUNGSTEN_CARBIDE PTFE POM NYLON RUBBER",
    "scene.excitation": "Impulse Displacement Profile Packet Riemann Drive Force",
    "scene.scene": "Scene",
    "simulation.api": "simulate resume",
    "simulation.many": "simulate_many",
    "simulation.planner": "plan",
    "simulation.run_folder": "Stopped",
    "simulation.time_averages": "averages Averages",
    "report.exploration": "explore",
    "sweeps.dispersion": "dispersion",
    "sweeps.run": "sweep",
    "sweeps.results": "load_sweep",
    "sweeps.strike_shares": "strike_shares",
    "trajectory.trajectory": "Trajectory",
    "benchmark.bench": "work_precision",
    "benchmark.own_run": "check check_deck",
    "doctor": "diagnose",
    "errors": "LmpchainError InputError ToleranceNotMet RunFailed EngineUnavailable",
    "chain": "laws patterns",
}
_PACKAGES = (
    "benchmark",
    "chain",
    "design",
    "disorder",
    "doctor",
    "engines",
    "measure",
    "orbits",
    "report",
    "stability",
    "theory",
    "trajectory",
)
__all__ = [*_PACKAGES, *" ".join(_MODULES.values()).split()]
__getattr__ = attributes(__name__, _PACKAGES, _MODULES | {"util.version": "__version__"})
__dir__ = listed(__name__)
load_mpi_before_lammps()
