"""An atlas as an xarray dataset in Zarr: a row a sample, filled block by block, or cells of the workspace.

With what its quantities are called.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.atlas.measures import SCALARS, Sampling, measured
from ffsms_pin.checks import FloatArray
from ffsms_pin.engine import Chunks
from ffsms_pin.errors import ResultError
from ffsms_pin.storage import told
from ffsms_pin.storage.files import staged_folder
from ffsms_pin.system import SpaceManipulator

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
# Rows that are measured together: some 30 MB stand in memory meanwhile.
_ROWS = 8192
_NUMBERED = re.compile(r"(sigma|assistance)_(\d+)")


@dataclass(frozen=True)
class Blocks:
    """A dataset with a row a sample, which several processes fill at once: work for `ffsms_pin.engine.run`.

    A block of rows is one chunk of the Zarr file at `path`, so no two processes ever write to the same file,
    and a block that is written again gives the same bytes. `rows` says how they are cut into blocks;
    directions are units (3,), base axes.
    """

    path: Path
    rows: Chunks
    sms: SpaceManipulator
    sampling: Sampling
    directions: tuple[tuple[float, ...], ...] = ()

    def make(self) -> None:
        """Write the dataset without its values, where it is not there yet, whole or not at all.

        Names, kinds and shapes are those of a table of one row.
        """
        if self.path.exists():
            return
        example = measured(self.sms, self.sampling.joints(range(1)), self.directions)
        variables = {
            name: (_DIMENSIONS.get(name, ("sample",)), values, described(name))
            for name, values in example.items()
        }
        modes = list(range(1, min(6, self.sms.n) + 1))
        coordinates = {"joint": self.sms.joint_names, "axis": list("xyz"), "mode": modes}
        if self.directions:
            coordinates["direction"] = [" ".join(f"{x:.6g}" for x in row) for row in self.directions]
        import xarray as xr  # with zarr it takes a second, and only atlases need it

        data = xr.Dataset(variables, coords=coordinates)
        chunks = {name: {"chunks": (self.rows.size, *data[name].shape[1:])} for name in variables}
        folder, name = self.path.parent, self.path.name
        with told(folder), staged_folder(folder, name) as staging:
            save(data, staging / name, encoding=chunks)
            group = _opened(staging / name)
            for variable in variables:
                group[variable].resize((self.rows.rows, *group[variable].shape[1:]))
            try:
                (staging / name).rename(self.path)
            except OSError:
                if not self.path.exists():  # no other shard was faster
                    raise

    def __call__(self, indices: range) -> dict[str, Any]:
        """Fill these blocks, and tell how many rows each has; `ResultError`: the disk is full, for one."""
        blocks = [self.rows.rows_of(block) for block in indices]
        with told(self.path):
            group = _opened(self.path)
            for rows in blocks:
                joints = self.sampling.joints(rows)
                few = (joints[k : k + _ROWS] for k in range(0, len(rows), _ROWS))
                parts = [measured(self.sms, some, self.directions) for some in few]
                for name in parts[0]:
                    group[name][rows.start : rows.stop] = np.concatenate([part[name] for part in parts])
        return {"rows": np.array([len(rows) for rows in blocks])}

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


def save(data: Any, path: Path, **how: Any) -> None:
    """Write a dataset."""
    data.to_zarr(path, consolidated=False, zarr_format=_FORMAT, **how)


def _opened(path: Path) -> Any:
    import zarr

    return zarr.open_group(path, mode="r+")


def values_of(variable: Any) -> Any:
    """A variable of an open atlas as an array; `ResultError`: a block of it is damaged."""
    try:
        return np.asarray(variable)
    except (RuntimeError, OSError, ValueError) as error:  # of zarr's codecs
        raise ResultError(str(variable.name), f"cannot be read from the atlas ({error})") from None


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


STATISTICS = ("mean", "least", "largest")
_AXES = ("x", "y", "z")

Tables = Callable[[], Iterator[Mapping[str, Any]]]


@dataclass(frozen=True)
class Cells:
    """Cubes that fill a box, in base axes from the base's centre of mass.

    The origin (3,) is the box's least corner [m], the edge that of a cube [m]. The shape is how many cubes
    stand along x, y, z: one along an axis on which the end effector does not move.
    """

    origin: FloatArray
    edge: float
    shape: tuple[int, ...]

    @classmethod
    def around(cls, least: FloatArray, largest: FloatArray, cells: int) -> Cells:
        """The cubes between two corners, `cells` of them along the longest side."""
        extent = largest - least
        edge = max(float(extent.max()), 1e-9) / cells
        shape = np.maximum(np.ceil(extent / edge - 1e-6), 1.0).astype(int)
        middle = 0.5 * (least + largest)
        return cls(middle - 0.5 * edge * shape, edge, tuple(shape.tolist()))

    def index(self, points: FloatArray) -> NDArray[np.intp]:
        """Number of the cube (N,) that each point (N, 3) is in; x slowest."""
        place = np.floor((points - self.origin) / self.edge).astype(int)
        place = np.clip(place, 0, np.array(self.shape) - 1)
        return np.asarray(np.ravel_multi_index(tuple(place.T), self.shape))

    def centres(self) -> dict[str, FloatArray]:
        """Centres of the cubes along each axis [m]."""
        return {
            name: self.origin[k] + self.edge * (np.arange(self.shape[k]) + 0.5)
            for k, name in enumerate(_AXES)
        }


def write_workspace(path: Path, tables: Tables, cells: int, attributes: Mapping[str, Any]) -> None:
    """Write the tables of an atlas as statistics over cells of the workspace, into a new folder.

    `tables` gives them; it is called twice: for the extent of the workspace, whose longest side has `cells`
    cells, and for the statistics.
    """
    import xarray as xr

    least, largest = np.full(3, np.inf), np.full(3, -np.inf)
    for table in tables():
        np.minimum(least, table["end_effector"].min(axis=0), out=least)
        np.maximum(largest, table["end_effector"].max(axis=0), out=largest)
    box = Cells.around(least, largest, cells)
    size = int(np.prod(box.shape))
    count, found = np.zeros(size, dtype=int), dict[str, FloatArray]()
    for table in tables():
        index = box.index(table["end_effector"].astype(np.float64))
        count += np.bincount(index, minlength=size)
        for name, values in _columns(table).items():
            one = found.setdefault(name, np.repeat([[0.0], [np.inf], [-np.inf]], size, axis=1))
            one[0] += np.bincount(index, values.astype(np.float64), minlength=size)
            np.minimum.at(one[1], index, values.astype(np.float64))
            np.maximum.at(one[2], index, values.astype(np.float64))
    variables: dict[str, Any] = {}
    for name, one in found.items():
        one[0] /= np.where(count > 0, count, 1)
        values = np.where(count > 0, one, np.nan).reshape(3, *box.shape)
        variables[name] = (("statistic", *_AXES), values, described(name))
    variables["count"] = (_AXES, count.reshape(box.shape), described("count"))
    coordinates = {
        "statistic": list(STATISTICS),
        **{name: ((name,), centres, {"units": "m"}) for name, centres in box.centres().items()},
    }
    data = xr.Dataset(variables, coords=coordinates, attrs={**attributes, "cell_edge_m": box.edge})
    save(data, path)


def _columns(table: Mapping[str, Any]) -> dict[str, Any]:
    """The quantities that a cell has statistics of; of several numbers a sample, one each."""
    assistance = np.transpose(table.get("assistance", np.empty((0, 0))))
    numbered = {f"assistance_{k}": values for k, values in enumerate(assistance, start=1)}
    return {"sigma_1": table["sigma"][:, 0], **{name: table[name] for name in SCALARS}, **numbered}
