"""The samples of an `opt.Path` in a CSV file."""

from __future__ import annotations

import io
import os
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ResultError
from ffsms_pin.files import read_content
from ffsms_pin.system.batch.stacks import rotations

_POSITION, _ATTITUDE = ("x", "y", "z"), ("qx", "qy", "qz", "qw")


class PathSamples(NamedTuple):
    """The samples of a path: positions (K, 3) [m], and attitudes (K, 3, 3) and times (K,) [s] or None."""

    positions: FloatArray
    attitudes: FloatArray | None = None
    times: FloatArray | None = None


def path_samples(path: str | os.PathLike[str]) -> PathSamples:
    """Read the samples of a path from a CSV file.

    The first line of the file names the columns, which are x, y, z [m] and, optionally, t [s] and the
    quaternion qx, qy, qz, qw. Quaternions are normalised. `ResultError` is raised if the file cannot be read,
    has other columns, or has a value that is not finite or a quaternion that is zero.
    """
    try:
        text = read_content(path).decode("utf-8-sig")
        table = None
        if text.strip():
            table = np.atleast_1d(np.genfromtxt(io.StringIO(text), delimiter=",", names=True))
    except FileNotFoundError:
        raise ResultError(path, "does not exist") from None
    except OSError as error:
        raise ResultError(path, f"cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise ResultError(path, f"cannot be read ({' '.join(str(error).split())})") from None
    if table is None:
        raise ResultError(path, "is empty")
    names = set(table.dtype.names or ())
    turned = len(names.intersection(_ATTITUDE))
    if names - {"t", *_POSITION, *_ATTITUDE} or set(_POSITION) - names or turned in (1, 2, 3):
        remedy = "must have columns x, y, z, and may have t and qx, qy, qz, qw, named in its first line"
        raise ResultError(path, f"{remedy}; it has {', '.join(table.dtype.names or ()) or 'no columns'}")
    columns = {name: np.asarray(table[name], dtype=np.float64) for name in table.dtype.names or ()}
    for name, numbers in columns.items():
        if not (finite := np.isfinite(numbers)).all():
            row = int(np.argmin(finite)) + 1
            raise ResultError(path, f"{name} of row {row} below the column names is not a finite number")
    positions, attitudes = np.column_stack([columns[name] for name in _POSITION]), None
    if turned:
        quaternions = np.stack([columns[name] for name in _ATTITUDE])
        if (zero := ~quaternions.any(axis=0)).any():
            row = int(np.argmax(zero)) + 1
            raise ResultError(path, f"the quaternion of row {row} below the column names is zero")
        attitudes = np.moveaxis(rotations(quaternions / np.linalg.norm(quaternions, axis=0)), -1, 0)
    return PathSamples(positions, attitudes, columns.get("t"))
