"""An atlas over the workspace: statistics of the samples whose end effector is in the same cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.atlas.dataset import described, save, xarray
from ffsms_pin.atlas.measures import SCALARS
from ffsms_pin.checks import FloatArray

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
    data = xarray().Dataset(variables, coords=coordinates, attrs={**attributes, "cell_edge_m": box.edge})
    save(data, path)


def _columns(table: Mapping[str, Any]) -> dict[str, Any]:
    """The quantities that a cell has statistics of; of several numbers a sample, one each."""
    assistance = np.transpose(table.get("assistance", np.empty((0, 0))))
    numbered = {f"assistance_{k}": values for k, values in enumerate(assistance, start=1)}
    return {"sigma_1": table["sigma"][:, 0], **{name: table[name] for name in SCALARS}, **numbered}
