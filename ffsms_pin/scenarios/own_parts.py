"""The terms and limits of [[term]] and [[limit]]: packaged ones by name, a user's own by import path."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import sys
from collections.abc import Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidScenario
from ffsms_pin.options.tables import radians
from ffsms_pin.scenarios.tables import PACKAGED

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

_KINDS: Mapping[str, type] = {"term": opt.Term, "limit": opt.Limit}
_IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


def made_part(scenario: Scenario, kind: str, number: int, values: Mapping[str, Any]) -> Any:
    """Make the term or limit of row `number` (from 1) of [[kind]].

    A user's modules are searched in the file's folder first. They are imported, which runs their code, only
    if the scenario allows it. `InvalidScenario` is raised if the class is missing, is no term or limit,
    rejects the values, or may not be imported.
    """
    source, use = scenario.source, values["use"]
    title = f"[[{kind}]] {number} use = '{use}'"
    arguments = {key: value for key, value in values.items() if key != "use"}
    if ":" not in use:
        return _called(source, title, PACKAGED[kind][use], radians(arguments))
    if not _IMPORT_PATH.fullmatch(use):
        raise InvalidScenario(source, f"{title} must be written package.module:Class")
    if not scenario.allow_import:
        raise InvalidScenario(
            source,
            f"{title} would run the code of that module; if you trust it, set allow_import=True",
        )
    part = _imported(source, title, use)
    if not (isinstance(part, type) and issubclass(part, _KINDS[kind])):
        raise InvalidScenario(source, f"{title} is no subclass of opt.{_KINDS[kind].__name__}")
    made = _called(source, title, part, arguments)
    if not (isinstance(getattr(made, "name", None), str) and made.name):
        raise InvalidScenario(source, f"{title} has no `name`; add a text of this name to the class")
    return made


def _imported(source: Path, title: str, use: str) -> Any:
    """Import an object by its path, with the file's folder first on sys.path."""
    module_name, _, class_name = use.partition(":")
    folder = str(source.resolve().parent)
    importlib.invalidate_caches()
    sys.path.insert(0, folder)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # user code may raise any exception
        raise InvalidScenario(source, f"{title} cannot be imported from {folder} ({_line(error)})") from error
    finally:
        sys.path.remove(folder)
    # Python loads a module once by its name and would reuse a loaded one of the same name from another
    # folder.
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
            source, f"{title} rejects these keys: {error} (its keys: {known or 'none'})"
        ) from None
    try:
        return part(**arguments)
    except FfsmsError as error:
        raise InvalidScenario(source, f"{title}: {error}") from None
    except Exception as error:  # user code may raise any exception
        raise InvalidScenario(source, f"{title} rejects these values ({_line(error)})") from error


def _line(error: Exception) -> str:
    """Return an error of a user's code in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
