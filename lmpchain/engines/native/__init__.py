"""The native engine: the choice of its step, its companion runs, and the estimate of its error.

`engine` is what a user names. A step comes from `step_choice`; `companion_run` moves the answer and
its companions, at the steps that `companions` names; `estimate` is the formula that makes an error
of their differences, with the rounding of `round_off` and what a scene makes of it,
`amplification`.
"""

from .engine import Native

__all__ = ["Native"]
