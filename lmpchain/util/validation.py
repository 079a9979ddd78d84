"""Input validation: pydantic models that report every fault at once, each with its key."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ..errors import InputError, shown
from .arrays import Array

NOT_GIVEN: Any = None  # default of array fields that are filled in when they are not given


class Checked(BaseModel):
    """A frozen value that raises `InputError` with every fault on construction."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def __init__(self, *values: Any, **data: Any):
        names = list(type(self).model_fields)
        if len(values) > len(names):
            raise InputError([("", f"takes {', '.join(names)}: {len(values)} values are too many")])
        data = dict(zip(names, values, strict=False)) | data
        known = {key: value for key, value in data.items() if key in names}
        faults = [(key, f"unknown key; the keys here are {', '.join(names)}") for key in data if key not in known]
        try:
            super().__init__(**known)
            faults += self._faults()
        except ValidationError as error:
            faults += _describe(error)
        if faults:
            raise InputError(faults)

    def _faults(self) -> Iterator[tuple[str, str]]:
        """Yield faults that concern several fields together."""
        yield from ()

    def given(self) -> dict[str, Any]:
        """Return the fields that the user gave, by name."""
        return {name: getattr(self, name) for name in sorted(self.model_fields_set, key=self._position)}

    def _position(self, name: str) -> int:
        return list(type(self).model_fields).index(name)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in type(self).model_fields
        )

    __hash__ = None  # type: ignore[assignment]  # arrays inside: compare, do not hash


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _vector(value: Any) -> Any:
    """Turn numbers into a read-only (n,) array of float64."""
    if value is None:
        return value
    if isinstance(value, list | tuple) and any(isinstance(item, bool | str) for item in value):
        raise ValueError("must be numbers")
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError("must be numbers") from None
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"must be a list of numbers, not of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"must be finite, but entry {int(np.argmin(np.isfinite(array))) + 1} is not")
    array.flags.writeable = False
    return array


def _positive_vector(value: Any) -> Any:
    array = _vector(value)
    if array is not None and not (array > 0).all():
        where = int(np.argmin(array > 0))
        raise ValueError(f"must be above 0, but entry {where + 1} is {array[where]:g}")
    return array


def _one_or_many(value: Any) -> Any:
    """A positive number as a float, or a list of them as an array."""
    value = _plain(value)
    if isinstance(value, bool | str):
        raise ValueError(f"must be a number or a list of numbers (got {shown(value)})")
    if isinstance(value, int | float):
        if not 0 < value <= sys.float_info.max:
            raise ValueError(f"must be a finite number above 0 (got {shown(value)})")
        return float(value)
    return _positive_vector(value)


Real = Annotated[float, BeforeValidator(_plain)]
Positive = Annotated[float, BeforeValidator(_plain), Field(gt=0)]
Whole = Annotated[int, BeforeValidator(_plain), Field(lt=2**63)]
Vector = Annotated[Array, BeforeValidator(_vector)]
PositiveVector = Annotated[Array, BeforeValidator(_positive_vector)]
OneOrMany = Annotated[float | Array, BeforeValidator(_one_or_many)]


def _describe(error: ValidationError) -> Iterator[tuple[str, str]]:
    """Yield (key, message) for every fault pydantic found, in the words of a physicist."""
    for fault in error.errors():
        key = ".".join(str(part) for part in fault["loc"])
        kind, value, limits = fault["type"], fault["input"], fault.get("ctx", {})
        got = shown(value) if isinstance(value, bool | int | float | str | list) else f"a {type(value).__name__}"
        if kind == "missing":
            message = "is missing; add it"
        elif kind == "finite_number":
            message = f"must be a finite number (got {shown(value)})"
        elif kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
            words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
            message = f"must be {'; '.join(f'{words[k]} {v}' for k, v in limits.items())} (got {got})"
        elif kind in ("int_type", "int_from_float"):
            message = f"must be a whole number (got {got})"
        elif kind == "float_type":
            message = f"must be a number (got {got})"
        elif kind in ("is_instance_of", "model_type", "model_attributes_type"):
            made = limits.get("class") or limits.get("class_name")
            message = f"must be of the type {made} (got {got}): make one, or read a scene file"
        elif kind == "literal_error":
            message = f"must be {limits['expected']} (got {got})"
        elif kind == "value_error" and isinstance(limits["error"], InputError):  # a value inside this one
            yield from limits["error"].under(key)
            continue
        elif kind == "value_error":
            message = str(limits["error"])
        else:
            message = f"{fault['msg'].lower()} (got {got})"
        yield key, message
