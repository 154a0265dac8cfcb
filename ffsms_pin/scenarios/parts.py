"""Terms and limits that a scenario file names: ours by a short name, a user's own by an import path."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import sys
from collections.abc import Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, TypeVar

from ffsms_pin.errors import FfsmsError, InvalidScenario
from ffsms_pin.opt import (
    AlphaBox,
    BaseLimits,
    BaseTurn,
    Clearance,
    Coupling,
    Effort,
    JointLimits,
    Limit,
    Propellant,
    Smooth,
    Term,
    TorqueLimits,
    WheelEnergy,
    WheelLimits,
    WheelMomentum,
)
from ffsms_pin.scenarios.keys import radians

__all__ = ["PACKAGED", "is_import_path", "made_part", "with_parts"]

PACKAGED: Mapping[str, Mapping[str, type]] = {
    "term": {
        "coupling": Coupling,
        "smooth": Smooth,
        "effort": Effort,
        "base-turn": BaseTurn,
        "wheel-momentum": WheelMomentum,
        "wheel-energy": WheelEnergy,
        "propellant": Propellant,
    },
    "limit": {
        "joints": JointLimits,
        "clearance": Clearance,
        "base": BaseLimits,
        "alpha-box": AlphaBox,
        "torques": TorqueLimits,
        "wheels": WheelLimits,
    },
}
"""The library's own terms and limits by their names in a scenario file."""

_KINDS: Mapping[str, type] = {"term": Term, "limit": Limit}
_NAME = r"[A-Za-z_]\w*"
_IMPORT_PATH = re.compile(rf"{_NAME}(\.{_NAME})*:{_NAME}")

Part = TypeVar("Part", Term, Limit)


def is_import_path(use: str) -> bool:
    """Whether `use` is a user's own class, as "package.module:Class"."""
    return ":" in use


def with_parts(given: list[Part], more: list[Part]) -> list[Part]:
    """Both lists; a part of the second takes the place of one of the same name in the first."""
    names = [part.name for part in more]
    return [part for part in given if part.name not in names] + more


def made_part(source: Path, kind: str, number: int, values: Mapping[str, Any], allow_import: bool) -> Any:
    """One term or limit of a scenario file.

    Parameters
    ----------
    source : Path
        The file, for messages; modules are looked for in its folder first.
    kind : {"term", "limit"}
    number : int
        Which of its kind in the file, from 1.
    values : mapping
        Its table: `use`, and the keyword arguments.
    allow_import : bool
        Whether modules of the user's own may be imported, which runs their code.

    Raises
    ------
    InvalidScenario
        The module or class is not there, is no term or limit, does not take the values, or may not be
        imported.
    """
    use = values["use"]
    title = f"[[{kind}]] {number} use = '{use}'"
    arguments = {key: value for key, value in values.items() if key != "use"}
    if not is_import_path(use):
        part = PACKAGED[kind][use]
        return _called(source, title, part, radians(arguments))
    if not _IMPORT_PATH.fullmatch(use):
        raise InvalidScenario(source, f"{title} must be written package.module:Class")
    if not allow_import:
        raise InvalidScenario(
            source,
            f"{title} would run the code of that module: allow it, if you trust it, with --allow-import "
            "(in Python: scenario(..., allow_import=True))",
        )
    part = _imported(source, title, use)
    if not (isinstance(part, type) and issubclass(part, _KINDS[kind])):
        raise InvalidScenario(source, f"{title} is no subclass of opt.{_KINDS[kind].__name__}")
    made = _called(source, title, part, arguments)
    if not isinstance(getattr(made, "name", None), str):
        raise InvalidScenario(source, f"{title} has no `name`: give the class one, a text")
    return made


def _imported(source: Path, title: str, use: str) -> Any:
    """What an import path names, with the file's folder first on sys.path while it is imported."""
    module_name, _, class_name = use.partition(":")
    folder = str(source.resolve().parent)
    importlib.invalidate_caches()
    sys.path.insert(0, folder)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the user's code raises
        raise InvalidScenario(source, f"{title} cannot be imported from {folder} ({_line(error)})") from error
    finally:
        sys.path.remove(folder)
    # A module is loaded once by its name: one of the same name from another folder would be taken for it.
    package = module_name.partition(".")[0]
    here = PathFinder.find_spec(package, [folder])
    loaded = getattr(sys.modules[package], "__file__", None) or "elsewhere"
    if here is not None and here.origin and os.path.realpath(here.origin) != os.path.realpath(loaded):
        raise InvalidScenario(
            source,
            f"{title}: another module '{package}' is loaded already ({loaded}); give yours another name",
        )
    if not hasattr(module, class_name):
        raise InvalidScenario(source, f"{title}: module '{module_name}' has no {class_name}")
    return getattr(module, class_name)


def _called(source: Path, title: str, part: Any, arguments: Mapping[str, Any]) -> Any:
    try:
        inspect.signature(part).bind(**arguments)
    except TypeError as error:
        known = ", ".join(name for name in inspect.signature(part).parameters if not name.startswith("_"))
        raise InvalidScenario(
            source, f"{title} does not take these keys: {error} (it takes: {known or 'none'})"
        ) from None
    try:
        return part(**arguments)
    except FfsmsError as error:
        raise InvalidScenario(source, f"{title}: {_line(error, named=False)}") from None
    except Exception as error:  # whatever the user's code raises
        raise InvalidScenario(source, f"{title} cannot be made of these values ({_line(error)})") from error


def _line(error: Exception, named: bool = True) -> str:
    """An error in one line."""
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words}" if named else words
