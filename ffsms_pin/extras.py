"""Packages that only parts of the library need, and the extras that install them."""

from __future__ import annotations

from importlib.util import find_spec

from ffsms_pin.errors import DependencyMissing

# Extra of pyproject.toml -> the modules that it brings.
EXTRAS = {
    "plot": ("matplotlib",),
    "view": ("meshcat", "umsgpack"),
    "robots": ("example_robot_data",),
    "mjcf": ("mujoco",),
    "cluster": ("dask", "distributed"),
}


def installed(extra: str) -> bool:
    """Return whether every module of an extra can be imported."""
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
