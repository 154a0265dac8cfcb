"""An atlas over the joints as an xarray dataset in Zarr: made empty once, then filled block by block.

Below: the packages that it needs, and what its quantities are called.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.atlas.measures import AtlasWork
from ffsms_pin.engine import Chunks
from ffsms_pin.errors import DependencyMissing, ResultError

# Of the file: what every version of the two packages from 2024 on reads and writes.
_FORMAT = 2
_DIMENSIONS = {
    "joints": ("sample", "joint"),
    "end_effector": ("sample", "axis"),
    "sigma": ("sample", "mode"),
    "assistance": ("sample", "direction"),
}
_NAMES_AND_UNITS = {
    "joints": ("joint position", "rad"),
    "end_effector": ("end effector from the base's centre of mass, base axes", "m"),
    "sigma": ("singular value of C_bm", "m/rad, rad/rad"),
    "entropy": ("entropy of the coupling", "1"),
    "manipulability": ("manipulability of J*", "volume of twists per rad"),
    "base_translation": ("base translation per end-effector metre", "m/m"),
    "base_rotation": ("base rotation per end-effector metre", "rad/m"),
    "assistance": ("coupling assistance", "1"),
    "count": ("samples in the cell", "1"),
}
_NUMBERED = re.compile(r"(sigma|assistance)_(\d+)")


@dataclass(frozen=True)
class Blocks:
    """A dataset with a row a sample, which several processes fill at once.

    A block of rows is one chunk of the Zarr file, so no two processes ever write to the same file, and a
    block that is written again gives the same bytes. `rows` says how they are cut into blocks.
    """

    path: Path
    rows: Chunks

    def make(self, example: Mapping[str, Any], coordinates: Mapping[str, Any]) -> None:
        """Write the dataset without its values: names, kinds and shapes are those of a table of one row."""
        variables = {
            name: (_DIMENSIONS.get(name, ("sample",)), np.asarray(values), described(name))
            for name, values in example.items()
        }
        data = xarray().Dataset(variables, coords=dict(coordinates))
        size = self.rows.size
        save(data, self.path, encoding={n: {"chunks": (size, *data[n].shape[1:])} for n in variables})
        group = _opened(self.path)
        for name in variables:
            group[name].resize((self.rows.rows, *group[name].shape[1:]))

    def write(self, block: int, table: Mapping[str, Any]) -> None:
        """Fill one block with the table of its rows; `ResultError` says that the disk is full, for one."""
        rows = self.rows.rows_of(block)
        try:
            group = _opened(self.path)
            for name, values in table.items():
                group[name][rows.start : rows.stop] = values
        except OSError as error:
            raise ResultError(self.path, f"cannot be written ({error.strerror or error})") from None

    def tables(self) -> Iterator[dict[str, Any]]:
        """The tables of the blocks in their order, one at a time."""
        group = _opened(self.path)
        names = [name for name, array in group.arrays() if array.attrs["_ARRAY_DIMENSIONS"][0] == "sample"]
        for block in range(len(self.rows)):
            rows = self.rows.rows_of(block)
            yield {name: group[name][rows.start : rows.stop] for name in names}

    def describe(self, attributes: Mapping[str, Any]) -> None:
        """Write the attributes of the dataset."""
        _opened(self.path).attrs.update(dict(attributes))


@dataclass(frozen=True)
class BlockWork:
    """The work of some blocks, for `ffsms_pin.engine.run`: fill them, and tell how many rows each has."""

    work: AtlasWork
    blocks: Blocks

    def __call__(self, indices: range) -> dict[str, Any]:
        """The table of these blocks, which are filled."""
        rows = [self.blocks.rows.rows_of(block) for block in indices]
        for block, here in zip(indices, rows, strict=True):
            self.blocks.write(block, self.work(here))
        return {"rows": np.array([len(here) for here in rows])}


def save(data: Any, path: Path, **how: Any) -> None:
    """Write a dataset."""
    data.to_zarr(path, consolidated=False, zarr_format=_FORMAT, **how)


def _opened(path: Path) -> Any:
    import zarr  # takes a third of a second, and only atlases need it

    return zarr.open_group(path, mode="r+")


def long_name(name: str) -> str:
    """A quantity in words; `sigma_1` is the first of several."""
    found = _NUMBERED.fullmatch(name)
    return f"{_NAMES_AND_UNITS[found[1]][0]} {found[2]}" if found else _NAMES_AND_UNITS[name][0]


def unit(name: str) -> str:
    """A quantity's unit."""
    found = _NUMBERED.fullmatch(name)
    return _NAMES_AND_UNITS[found[1] if found else name][1]


def described(name: str) -> dict[str, str]:
    """A quantity's attributes in a dataset."""
    return {"units": unit(name), "long_name": long_name(name)}


def check_installed() -> None:
    """Raise `DependencyMissing` where xarray or zarr is not installed, without importing them."""
    if find_spec("xarray") is None or find_spec("zarr") is None:
        raise DependencyMissing("xarray or zarr", "an atlas", "cluster")


def xarray() -> Any:
    """The module xarray, with zarr beside it; `DependencyMissing` where one is not installed."""
    check_installed()
    import xarray

    return xarray
