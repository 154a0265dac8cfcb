"""Robot descriptions that ship with the library."""

from __future__ import annotations

from pathlib import Path

__all__ = ["model_names", "model_path"]

_FOLDER = Path(__file__).parent


def model_names() -> list[str]:
    """Names of the packaged models, sorted; each can be given to `ffsms_pin.load`."""
    return sorted(path.stem for path in _FOLDER.glob("*.urdf"))


def model_path(name: str) -> Path:
    """Path of the packaged model `name` (it need not exist; see `model_names`)."""
    return _FOLDER / f"{name}.urdf"
