"""The packages that only atlases need."""

from __future__ import annotations

from typing import Any

from ffsms_pin.errors import DependencyMissing

__all__ = ["xarray"]


def xarray() -> Any:
    """The module xarray, with zarr beside it.

    Raises
    ------
    DependencyMissing
        One of them is not installed.
    """
    try:
        import xarray
        import zarr  # noqa: F401
    except ImportError:
        raise DependencyMissing("xarray or zarr", "an atlas", "cluster") from None
    return xarray
