"""Input validation by pydantic models that report all faults at once, each with its key."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import Parameter, Signature
from typing import Annotated, Any, ClassVar, NoReturn, Self, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ..errors import InputError, did_you_mean, shown, unknown_key
from .arrays import Array, numbers, objection, plain, read_only
from .lazy import cached_property
from .notebook import Shown
from .remarks import warn

NOT_GIVEN: Any = None  # Default of array fields that are computed if they are not given.


class Checked(Shown, BaseModel):
    """A frozen value that raises `InputError` with all faults at construction.

    The method `replace` returns a changed copy, which is also checked.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        ignored_types=(cached_property,),
    )

    # Attribute of each argument. The two names differ if the value is computed from other fields
    # when the argument is not given.
    arguments: ClassVar[dict[str, str]] = {}
    # Advice for names that are not arguments but may be confused with one.
    elsewhere: ClassVar[dict[str, str]] = {}
    # Further arguments that a class converts to fields.
    other_arguments: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Store the names of the arguments, and let `help` list them first with their defaults."""
        cls.arguments = {field.alias or name: name for name, field in cls.model_fields.items()}
        parameters = []
        for name, field in cls.model_fields.items():
            default = Parameter.empty if field.is_required() else field.default
            parameters.append(
                Parameter(field.alias or name, Parameter.KEYWORD_ONLY, default=default)
            )
        parameters += [
            Parameter(name, Parameter.KEYWORD_ONLY, default=None) for name in cls.other_arguments
        ]
        cls.__signature__ = Signature(parameters)

    def _fields(self) -> Iterator[tuple[str, Any]]:
        yield from self.given().items()

    def __repr__(self) -> str:
        return Shown.__repr__(self)

    __str__ = __repr__

    def __init__(self, *values: Any, **data: Any):
        names = self.arguments
        if values:
            if len(values) > len(names):
                fault = f"accepts {', '.join(names)}: {len(values)} values are too many"
                raise InputError.at("", fault)
            placed = dict(zip(names, values, strict=False))
            if twice := [name for name in placed if name in data]:
                fault = "is given twice, by position and by name: give every argument by name"
                raise InputError((name, fault) for name in twice)
            data |= placed
        faults = []
        if not data.keys() <= set(names):
            faults = [(key, self._unknown(key)) for key in data if key not in names]
            data = {key: value for key, value in data.items() if key in names}
        try:
            super().__init__(**data)
            faults += self._faults()
        except ValidationError as error:
            faults += _describe(error)
        if faults:
            raise InputError(faults)
        # Only valid values are worth a remark.
        for remark in self._remarks():
            # The stack level refers to one line here, so that Python shows each warning once.
            warn(remark, stacklevel=1)

    @classmethod
    def _unknown(cls, key: str) -> str:
        """Return the fault of a key that is not an argument."""
        if key in cls.elsewhere:
            return f"is not a key here: {cls.elsewhere[key]}"
        return unknown_key(key, [*cls.arguments, *cls.other_arguments], cls.elsewhere)

    def _remarks(self) -> Iterator[str]:
        """Yield warnings about valid but unlikely values."""
        yield from ()

    def _faults(self) -> Iterator[tuple[str, str]]:
        """Yield faults that concern several fields together."""
        yield from ()

    def replace(self, **changes: Any) -> Self:
        """Return a checked copy with these fields changed; None removes an optional field.

        Raises
        ------
        InputError
            If the copy is invalid. The error contains all faults.
        """
        fields = self.given() | changes
        return type(self)(**{key: value for key, value in fields.items() if value is not None})

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return this immutable value, or a copy by `replace`."""
        return self.replace(**update) if update else self

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: Any = None) -> Self:
        return self

    def copy(self, **options: Any) -> Self:
        """Return this value; use `replace` to change fields."""
        update = options.pop("update", None)
        if any(value is not None for key, value in options.items() if key != "deep"):
            raise InputError.at(
                "copy", "copies all fields: use .replace(...) to change some of them"
            )
        return self.model_copy(update=update)

    @classmethod
    def model_construct(cls, *_: Any, **__: Any) -> NoReturn:  # type: ignore[override]
        """Raise `InputError`, because unchecked values are not allowed."""
        raise InputError.at(
            cls.__name__, f"must be checked: use {cls.__name__}(...), or its method replace"
        )

    def __setattr__(self, name: str, value: Any) -> None:
        raise InputError.at(
            name, f"cannot be changed: use .replace({name}=...), which returns a checked copy"
        )

    def __delattr__(self, name: str) -> None:
        raise InputError.at(
            name, "cannot be deleted: use .replace(...), which returns a checked copy"
        )

    def __getstate__(self) -> dict[Any, Any]:
        """Return the state without cached properties."""
        state = super().__getstate__()
        values = state["__dict__"].items()
        fields = {key: value for key, value in values if key in type(self).model_fields}
        return state | {"__dict__": fields}

    def __setstate__(self, state: dict[Any, Any]) -> None:
        super().__setstate__(state)
        for value in self.__dict__.values():
            # Pickling does not preserve the write protection.
            read_only(value)

    def given(self) -> dict[str, Any]:
        """Return the fields that the user gave, by name."""
        fields = self.model_fields_set
        return {key: getattr(self, name) for key, name in self.arguments.items() if name in fields}

    def _compared(self) -> Iterable[str]:
        """Return the arguments that determine equality."""
        return self.arguments

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and all(
            np.array_equal(getattr(self, key), getattr(other, key)) for key in self._compared()
        )

    def __hash__(self) -> int:
        # Equal values may be given by different fields, which pydantic would use for the hash.
        values = (getattr(self, key) for key in self._compared())
        return hash((type(self), *map(_hashable, values)))

    def __dir__(self) -> list[str]:
        """Return the names of this value without pydantic's additional names."""
        of_python = set(dir(object))
        of_pydantic = set(dir(BaseModel)) - of_python
        names = set(super().__dir__()) - of_pydantic
        return [name for name in names if not name.startswith("__") or name in of_python]


Value = TypeVar("Value", bound=Checked)
Made = TypeVar("Made")


def make_unchecked(kind: type[Value], **fields: Any) -> Value:
    """Return a value from arguments that are known to be valid, without checks.

    The corresponding function of pydantic takes ten times as long.
    """
    values = {kind.arguments[key]: value for key, value in fields.items()}
    defaults = {
        name: field.default
        for name, field in kind.model_fields.items()
        if name not in values and not field.is_required()
    }
    value = object.__new__(kind)
    object.__setattr__(value, "__dict__", values | defaults)
    object.__setattr__(value, "__pydantic_fields_set__", set(values))
    object.__setattr__(value, "__pydantic_extra__", None)
    object.__setattr__(value, "__pydantic_private__", None)
    return value


def with_derived(value: Value, **derived: Any) -> Value:
    """Return a new value with these cached properties, derived elsewhere."""
    value.__dict__.update(derived)
    return value


def each(items: Iterable[Any], make: Callable[[Any], Made]) -> tuple[Made, ...]:
    """Return the results of `make` for all items; raise `InputError` with all faults by index."""
    values = []
    faults: list[tuple[str, str]] = []
    for place, item in enumerate(items):
        # A fault of one item must not hide the faults of the others.
        try:
            values.append(make(item))
        except InputError as error:
            faults += error.under(str(place))
        except ValueError as error:
            faults.append((str(place), str(error)))
    if faults:
        raise InputError(faults)
    return tuple(values)


def _hashable(value: Any) -> Any:
    """Return a hashable form that is the same for equal values, such as 0 and -0."""
    return (value + 0.0).tobytes() if isinstance(value, np.ndarray) else value


def _plain(value: Any) -> Any:
    """Return a NumPy number as a Python number; reject values that pydantic would convert."""
    convertible = hasattr(value, "__float__") and not isinstance(value, int | float)
    if convertible and (reason := objection(value)):
        raise ValueError(reason)
    return plain(value)


def _vector(value: Any) -> Any:
    """Convert numbers to a read-only (n,) array of float64."""
    if value is None:
        raise ValueError("must be a list of numbers: leave it out if it is not given")
    # A copy cannot be changed by the caller later.
    array = np.array(numbers(value))
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"must be a list of numbers, not of shape {array.shape}")
    if not np.isfinite(array).all():
        entry = int(np.argmin(np.isfinite(array))) + 1
        raise ValueError(f"must be finite, but entry {entry} is not")
    return read_only(array)


def _positive_vector(value: Any) -> Any:
    array = _vector(value)
    if not (array > 0).all():
        entry = int(np.argmin(array > 0))
        raise ValueError(f"must be above 0, but entry {entry + 1} is {array[entry]:g}")
    return array


def _one_or_many(value: Any) -> Any:
    """Return a positive number as a float, or a list of them as an array."""
    value = plain(value)
    if isinstance(value, bool | str):
        raise ValueError(f"must be a number or a list of numbers (got {shown(value)})")
    if isinstance(value, int | float):
        if not 0 < value <= sys.float_info.max:
            raise ValueError(f"must be a finite number above 0 (got {shown(value)})")
        return float(value)
    return _positive_vector(value)


def check_positive(key: str, value: Any, what: str = "a number above 0") -> float:
    """Return a positive number; raise `InputError` with the text `what` for other values."""
    real = isinstance(value, int | float | np.floating) and not isinstance(value, bool)
    if not real or not 0 < value < np.inf:
        raise InputError.at(key, f"must be {what} (got {shown(value)})")
    return float(value)


def check_whole(key: str, value: Any, low: int) -> int:
    """Return a whole number of at least `low`; raise `InputError` for other values."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < low:
        raise InputError.at(key, f"must be a whole number from {low} (got {shown(value)})")
    return int(value)


def non_negative(value: Any) -> Any:
    """Return a non-negative number as a float, or a list of them as an array."""
    value = _plain(value)
    if isinstance(value, bool | str):
        raise ValueError(f"must be a number or a list of numbers (got {shown(value)})")
    if isinstance(value, int | float):
        if not 0 <= value <= sys.float_info.max:
            raise ValueError(f"must be a finite number from 0 (got {shown(value)})")
        return float(value)
    array = _vector(value)
    if not (array >= 0).all():
        entry = int(np.argmin(array >= 0))
        raise ValueError(f"must be from 0, but entry {entry + 1} is {array[entry]:g}")
    return array


Real = Annotated[float, BeforeValidator(_plain)]
Positive = Annotated[float, BeforeValidator(_plain), Field(gt=0)]
Whole = Annotated[int, BeforeValidator(_plain), Field(lt=2**63)]
Vector = Annotated[Array, BeforeValidator(_vector)]
PositiveVector = Annotated[Array, BeforeValidator(_positive_vector)]
OneOrMany = Annotated[float | Array, BeforeValidator(_one_or_many)]


def _describe(error: ValidationError) -> Iterator[tuple[str, str]]:
    """Yield (key, message) for every fault that pydantic found, in plain words."""
    for fault in error.errors():
        key = ".".join(map(str, fault["loc"]))
        cause = fault.get("ctx", {}).get("error")
        if isinstance(cause, InputError):
            # The fault is in a nested value.
            yield from cause.under(key)
        elif fault["type"] == "value_error":
            yield key, str(cause)
        elif fault["type"] == "missing":
            yield key, "is missing; add it"
        else:
            yield key, _name_kind(fault["type"], fault["input"], fault.get("ctx", {}), fault["msg"])


def _name_kind(fault: str, value: Any, limits: Mapping[str, Any], message: str) -> str:
    """Return our message for a fault, or pydantic's message for rare faults."""
    simple = isinstance(value, bool | int | float | str | list)
    got = f"(got {shown(value) if simple else f'a {type(value).__name__}'})"
    if fault == "finite_number":
        return f"must be a finite number {got}"
    if fault in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
        return f"must be {'; '.join(f'{words[k]} {v}' for k, v in limits.items())} {got}"
    if fault in ("int_type", "int_from_float"):
        return f"must be a whole number {got}"
    if fault == "float_type":
        return f"must be a number {got}"
    if fault in ("is_instance_of", "model_type", "model_attributes_type"):
        kind = limits.get("class") or limits.get("class_name")
        return f"must be of the type {kind} {got}: make one, or read a scene file"
    if fault == "literal_error":
        names = re.findall("'(.*?)'", limits["expected"])
        return f"must be {limits['expected']} {got}{did_you_mean(value, names)}"
    return f"{message.lower()} {got}"
