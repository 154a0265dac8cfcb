"""An atlas over the workspace: statistics of the samples whose end effector is in the same cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.atlas.dataset import long_name, save, unit, xarray
from ffsms_pin.atlas.measures import SCALARS
from ffsms_pin.checks import FloatArray

__all__ = ["STATISTICS", "Cells", "write_workspace"]

STATISTICS = ("mean", "least", "largest")
_AXES = ("x", "y", "z")

Tables = Callable[[], Iterator[Mapping[str, Any]]]


@dataclass(frozen=True)
class Cells:
    """Cubes that fill a box, in base axes from the base's centre of mass.

    Attributes
    ----------
    origin : ndarray, shape (3,)
        The box's least corner [m].
    edge : float
        Of a cube [m].
    shape : tuple of int
        Cubes along x, y, z; one along an axis on which the end effector does not move.
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


@dataclass
class _Statistics:
    """Running mean, least and largest of one quantity in every cell."""

    cells: int
    total: FloatArray = field(init=False)
    least: FloatArray = field(init=False)
    largest: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.total = np.zeros(self.cells)
        self.least = np.full(self.cells, np.inf)
        self.largest = np.full(self.cells, -np.inf)

    def add(self, index: NDArray[np.intp], values: FloatArray) -> None:
        self.total += np.bincount(index, values, minlength=self.cells)
        np.minimum.at(self.least, index, values)
        np.maximum.at(self.largest, index, values)

    def result(self, count: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """(3, x, y, z), in the order of `STATISTICS`; NaN in cells without a sample."""
        there = count > 0
        mean = self.total / np.where(there, count, 1)
        found = np.where(there, np.stack([mean, self.least, self.largest]), np.nan)
        return found.reshape(3, *shape)


def write_workspace(path: Path, tables: Tables, cells: int, attributes: Mapping[str, Any]) -> None:
    """Write the tables of an atlas as statistics over cells of the workspace.

    Parameters
    ----------
    path : Path
        A folder that is not there yet.
    tables : callable
        Gives the tables; it is called twice: for the extent of the workspace, and for the statistics.
    cells : int
        Along the longest side of the workspace.
    attributes : mapping
        Of the dataset.
    """
    least, largest = np.full(3, np.inf), np.full(3, -np.inf)
    for table in tables():
        np.minimum(least, table["end_effector"].min(axis=0), out=least)
        np.maximum(largest, table["end_effector"].max(axis=0), out=largest)
    box = Cells.around(least, largest, cells)
    size = int(np.prod(box.shape))
    count, found = np.zeros(size, dtype=int), dict[str, _Statistics]()
    for table in tables():
        index = box.index(table["end_effector"].astype(np.float64))
        count += np.bincount(index, minlength=size)
        for name, values in _columns(table).items():
            found.setdefault(name, _Statistics(size)).add(index, values.astype(np.float64))
    arrays: dict[str, Any] = {
        name: (("statistic", *_AXES), statistics.result(count, box.shape))
        for name, statistics in found.items()
    }
    arrays["count"] = (_AXES, count.reshape(box.shape))
    variables = {
        name: (*array, {"units": unit(name), "long_name": long_name(name)}) for name, array in arrays.items()
    }
    coordinates = {
        "statistic": list(STATISTICS),
        **{name: ((name,), centres, {"units": "m"}) for name, centres in box.centres().items()},
    }
    data = xarray().Dataset(variables, coords=coordinates, attrs={**attributes, "cell_edge_m": box.edge})
    save(data, path)


def _columns(table: Mapping[str, Any]) -> dict[str, Any]:
    """The quantities that a cell has statistics of; of several numbers a sample, one each."""
    columns = {"sigma_1": table["sigma"][:, 0], **{name: table[name] for name in SCALARS}}
    for k, values in enumerate(np.transpose(table.get("assistance", np.empty((0, 0)))), start=1):
        columns[f"assistance_{k}"] = values
    return columns
