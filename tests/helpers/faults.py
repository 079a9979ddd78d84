"""The faults with which a call is rejected, and its remarks."""

import warnings
from collections.abc import Callable
from typing import Any

import pytest

from lmpchain import InputError


def faults(call: Callable[..., Any], *values: Any, **options: Any) -> list[tuple[str, str]]:
    """Return the keys and messages with which a call is rejected."""
    with pytest.raises(InputError) as caught:
        call(*values, **options)
    return caught.value.faults


def fault_keys(call: Callable[..., Any], *values: Any, **options: Any) -> list[str]:
    """Return the keys of the faults with which a call is rejected."""
    return [key for key, _ in faults(call, *values, **options)]


def remarks(call: Callable[..., Any], *values: Any, **options: Any) -> list[str]:
    """Return the warnings of a call."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(*values, **options)
    return [str(warning.message) for warning in caught]
