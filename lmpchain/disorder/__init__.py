"""Random chains, averages over them, and localisation in them."""

from ..util.lazy import attributes, listed

__all__ = [
    "DensityOfStates",
    "Ensemble",
    "Localisation",
    "MeasuredEnsemble",
    "Spreading",
    "at_the_end",
    "density_of_states",
    "disordered",
    "ensemble",
    "factors",
    "lyapunov",
    "measured_over",
    "realisation",
    "spreading",
    "statistics",
    "within",
]
__getattr__ = attributes(
    __name__,
    names={
        "averages": "Ensemble at_the_end ensemble",
        "draws": "disordered factors realisation",
        "measured": "MeasuredEnsemble measured_over statistics within",
        "spread": "Spreading spreading",
        "transfer_matrix": "DensityOfStates Localisation density_of_states lyapunov",
    },
)
__dir__ = listed(__name__)
