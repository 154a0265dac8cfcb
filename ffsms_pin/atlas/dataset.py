"""An atlas over the joints as an xarray dataset in Zarr, written one chunk at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.atlas.labels import long_name, unit
from ffsms_pin.atlas.packages import xarray

__all__ = ["FORMAT", "save", "write_samples"]

# Of the file: what every version of the two packages from 2024 on reads and writes.
FORMAT = 2
_DIMENSIONS = {
    "joints": ("sample", "joint"),
    "end_effector": ("sample", "axis"),
    "sigma": ("sample", "mode"),
    "assistance": ("sample", "direction"),
}


def write_samples(
    path: Path,
    tables: Iterator[Mapping[str, Any]],
    size: int,
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> None:
    """Write the tables of an atlas as one dataset with a row a sample.

    Parameters
    ----------
    path : Path
        A folder that is not there yet.
    tables : iterator of mapping
        As `measured` gives them, in order.
    size : int
        Rows of every table but the last: the dataset's chunks, so that each is written once.
    coordinates, attributes : mapping
        Of the dataset.
    """
    for k, table in enumerate(tables):
        data = _dataset(table, coordinates, attributes)
        if k == 0:
            encoding = {name: {"chunks": (size, *data[name].shape[1:])} for name in data.data_vars}
            save(data, path, encoding=encoding)
        else:
            save(data.drop_vars(list(coordinates)), path, append_dim="sample")


def save(data: Any, path: Path, **how: Any) -> None:
    """Write a dataset, or append to one."""
    data.to_zarr(path, consolidated=False, zarr_format=FORMAT, **how)


def _dataset(table: Mapping[str, Any], coordinates: Mapping[str, Any], attributes: Mapping[str, Any]) -> Any:
    variables = {
        name: (
            _DIMENSIONS.get(name, ("sample",)),
            np.asarray(values),
            {"units": unit(name), "long_name": long_name(name)},
        )
        for name, values in table.items()
    }
    return xarray().Dataset(variables, coords=dict(coordinates), attrs=dict(attributes))
