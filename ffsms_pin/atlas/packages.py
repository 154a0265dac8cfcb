"""The packages that only atlases need."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from ffsms_pin.errors import DependencyMissing

__all__ = ["check_installed", "xarray"]


def check_installed() -> None:
    """Raise `DependencyMissing` where xarray or zarr is not installed, without importing them."""
    if find_spec("xarray") is None or find_spec("zarr") is None:
        raise DependencyMissing("xarray or zarr", "an atlas", "cluster")


def xarray() -> Any:
    """The module xarray, with zarr beside it.

    Raises
    ------
    DependencyMissing
        One of them is not installed.
    """
    check_installed()
    import xarray

    return xarray
