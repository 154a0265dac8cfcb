"""The packaged robot descriptions."""

from __future__ import annotations

from pathlib import Path

__all__ = ["model_names", "model_path"]

_FOLDER = Path(__file__).parent


def model_names() -> list[str]:
    """Return the sorted names of the packaged models, which `ffsms_pin.load` accepts."""
    return sorted(path.stem for path in _FOLDER.glob("*.urdf"))


def model_path(name: str) -> Path:
    """Return the path of the packaged model `name`, which need not exist; see `model_names`."""
    return _FOLDER / f"{name}.urdf"
