"""Fits of the theory to a trajectory, and of the parameters of a scene to a measurement."""

from ...util.lazy import attributes, listed

_NAMES = {
    "overview": "FrontPassage Summary fit_passage summary",
    "waves": "BesselFit ModeFit fit_bessel fit_modes",
    "column": "ContinuumFit ExponentFit FrontLaw fit_continuum fit_exponents",
    "solitary": "SolitonFit fit_soliton",
    "inverse": "ParameterFit Trace fit_parameter",
}
__all__ = [name for names in _NAMES.values() for name in names.split()]
__getattr__ = attributes(__name__, names=_NAMES)
__dir__ = listed(__name__)
