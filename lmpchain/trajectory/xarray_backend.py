"""A run folder as an xarray dataset for `xarray.open_dataset("folder")`."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import xarray
from xarray.backends import BackendEntrypoint

from .zarr_store import NAME

DECODERS = (
    "mask_and_scale",
    "decode_times",
    "concat_characters",
    "use_cftime",
    "decode_timedelta",
    "decode_coords",
)


class RunFolderBackend(BackendEntrypoint):
    """Backend that opens a folder of `lmpchain run -o folder/`, even during the run.

    The dataset is the same as that of `Trajectory.to_xarray`. It contains the displacement (m) and
    the velocity (m/s) over time and grain; the scene, the engine and the error estimate are
    attributes. Arrays remain on disk until they are used. The entry points of the package register
    this class with xarray.
    """

    description = "Open run folders of lmpchain"
    open_dataset_parameters = ("filename_or_obj", "drop_variables", *DECODERS)

    def open_dataset(  # type: ignore[override]
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        **decoders: Any,
    ) -> xarray.Dataset:
        """Return the dataset of a run folder without the dropped variables.

        The `decoders` of xarray are accepted but have no effect, because values are not encoded and
        times are numbers of seconds.
        """
        if unknown := decoders.keys() - DECODERS:
            raise TypeError(f"lmpchain has no option {', '.join(sorted(unknown))}")
        from .trajectory import Trajectory

        dataset = Trajectory.load(filename_or_obj).to_xarray()
        return dataset.drop_vars(drop_variables) if drop_variables else dataset

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Return whether this is a folder with the samples of a run."""
        return (
            isinstance(filename_or_obj, str | PathLike) and (Path(filename_or_obj) / NAME).is_dir()
        )
