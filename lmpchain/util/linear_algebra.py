"""Thread control of BLAS and LAPACK."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
Result = TypeVar("Result")


@cache
def _controller() -> ThreadpoolController:
    # The controller searches the loaded libraries, which takes 5 ms.
    return ThreadpoolController()


def in_one_thread(function: Callable[P, Result]) -> Callable[P, Result]:
    """Return a function whose linear algebra runs in one thread.

    Several threads do not accelerate the linear algebra of matrices with some hundred rows, and on
    a busy machine they wait for each other. The eigenvalues of a 99 x 99 matrix then take 240 ms
    instead of 2 ms.
    """

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> Result:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return alone
