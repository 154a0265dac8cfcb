"""Robot descriptions that ship with the library."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

__all__ = ["model_names", "model_path"]


def model_names() -> list[str]:
    """Names of the packaged models, sorted; each can be given to `ffsms_pin.load`."""
    folder = files("ffsms_pin.urdf")
    return sorted(item.name[: -len(".urdf")] for item in folder.iterdir() if item.name.endswith(".urdf"))


def model_path(name: str) -> Path:
    """Path of the packaged model `name` (it need not exist; see `model_names`)."""
    return Path(str(files("ffsms_pin.urdf") / f"{name}.urdf"))
