"""Excitations with arrays that may be read from files of instruments."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ..errors import InputError
from ..util.remarks import note
from .base import Excitation
from .trace_file import Reading, TableFile


class Measured(Excitation):
    """An excitation with arrays that may be read from a file, with a record of the reading.

    Attributes
    ----------
    file_kind : type
        Class that reads the file: a `TableFile` with its options.
    source : str, optional
        How the file was read; ignored when excitations are compared.
    """

    file_kind: ClassVar[type[TableFile]]
    if TYPE_CHECKING:
        source: str

    def __init_subclass__(cls, **options: Any) -> None:
        """Add the options of the file to the arguments of the class."""
        super().__init_subclass__(**options)
        if "file_kind" in vars(cls):
            cls.other_arguments = tuple(cls.file_kind.arguments)

    def __init__(self, *values: Any, **data: Any):
        options = {key: data.pop(key) for key in self.other_arguments if key in data}
        reading = self._read(options, data) if options else None
        super().__init__(*values, **data)
        if reading:
            note(reading.text)

    def _read(self, options: dict[str, Any], data: dict[str, Any]) -> Reading:
        """Add the arrays of a file, and a description of how it was read, to the data."""
        if unknown := [key for key in data if key not in self.arguments]:
            raise InputError((key, self._unknown(key)) for key in unknown)
        if options.get("file") is None:
            raise InputError((key, "requires a file: give file") for key in options)
        file = self.file_kind(**{key: value for key, value in options.items() if value is not None})
        reading, arrays = self._arrays(file)
        if twice := [key for key in (*arrays, "source") if data.get(key) is not None]:
            cure = "is in the file already; take it out of one of them"
            raise InputError((key, cure) for key in twice)
        data |= arrays | {"source": reading.text}
        return reading

    @classmethod
    def _arrays(cls, file: Any) -> tuple[Reading, dict[str, Any]]:
        """Read a file, and return the fields that its columns define."""
        raise NotImplementedError

    def replace(self, **changes: Any) -> Self:
        """Return a checked copy with these fields changed.

        The copy has no `source` if its arrays differ from those in the file.
        """
        described = {"grain", "start", "interpolation", "source"}
        source = {} if changes.keys() <= described else {"source": None}
        return super().replace(**source | changes)

    def _compared(self) -> Iterable[str]:
        return [key for key in self.arguments if key != "source"]
