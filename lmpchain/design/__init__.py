"""Gradients of a result of a run with respect to the parameters of a chain."""

from ..util.lazy import attributes, listed

_MODULES = {
    "fitting": "fit Fit",
    "gradients": "gradient Gradient",
    "optimisation": "optimise Optimum",
    "traces": "Traces",
    "sensitivities": "sensitivity Sensitivity",
    "objectives": "ArrivalTime DriveWork Energy Function KineticEnergy Misfit Momentum PeakForce"
    " Seen Slopes",
}
__all__ = " ".join(_MODULES.values()).split()
__getattr__ = attributes(__name__, (), _MODULES)
__dir__ = listed(__name__)
