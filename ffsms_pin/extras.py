"""Packages that only parts of the library need: what they are called, and which extra brings them."""

from __future__ import annotations

from importlib.util import find_spec

from ffsms_pin.errors import DependencyMissing

# Extra of pyproject.toml -> the modules that it brings.
EXTRAS = {
    "plot": ("matplotlib",),
    "view": ("meshcat", "tornado"),
    "record": ("PIL", "imageio_ffmpeg"),
    "robots": ("example_robot_data",),
    "gym": ("gymnasium",),
    "basilisk": ("Basilisk",),
    "pink": ("pink", "qpsolvers"),
    "cluster": ("dask", "distributed", "xarray", "zarr", "pyarrow", "pandas"),
}


def installed(extra: str) -> bool:
    """Whether every module of an extra can be imported."""
    return all(find_spec(module) is not None for module in EXTRAS[extra])


def require(extra: str, needed_for: str) -> None:
    """Raise `DependencyMissing` with the command that installs an extra, where one of its modules is missing.

    Parameters
    ----------
    extra : str
        A key of `EXTRAS`.
    needed_for : str
        What cannot be done without it, the subject of the message.
    """
    for module in EXTRAS[extra]:
        if find_spec(module) is None:
            raise DependencyMissing(module, needed_for, extra)
