"""Scenario files as files: those that ship with the library, and what a TOML file holds."""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidScenario, meant
from ffsms_pin.storage import read_content

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["packaged_path", "read", "scenario_names"]


def scenario_names() -> list[str]:
    """Names of the scenarios that ship with the library."""
    folder = files("ffsms_pin.scenarios")
    return sorted(item.name[: -len(".toml")] for item in folder.iterdir() if item.name.endswith(".toml"))


def packaged_path(name: str) -> Path:
    """File of a scenario that ships with the library."""
    return Path(str(files("ffsms_pin.scenarios") / f"{name}.toml"))


def read(source: Path) -> dict[str, Any]:
    """What a TOML file holds.

    Raises
    ------
    InvalidScenario
        The file is missing, cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(read_content(source).decode("utf-8-sig"))
    except (FileNotFoundError, NotADirectoryError):
        packaged = ", ".join(scenario_names())
        guess = meant(source, scenario_names())
        raise InvalidScenario(
            source,
            f"there is no such file, nor a packaged scenario of that name ({packaged})"
            + (f"; {guess}" if guess else ""),
        ) from None
    except OSError as error:
        raise InvalidScenario(source, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InvalidScenario(source, "is not a TOML file (not UTF-8 text)") from None
    except (ValueError, RecursionError) as error:  # also a path with a null character
        raise InvalidScenario(source, f"is not a TOML file ({error})") from None
