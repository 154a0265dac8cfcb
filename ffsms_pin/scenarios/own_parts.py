"""The terms and limits of [[term]] and [[limit]]: packaged ones by name, a user's own by import path."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidScenario
from ffsms_pin.options.own_classes import in_one_line, own_class
from ffsms_pin.options.tables import radians
from ffsms_pin.scenarios.tables import PACKAGED

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

_KINDS: Mapping[str, type] = {"term": opt.Term, "limit": opt.Limit}


def made_part(scenario: Scenario, kind: str, number: int, values: Mapping[str, Any]) -> Any:
    """Make the term or limit of row `number` (from 1) of [[kind]].

    The search for a user's module begins in the file's folder. The import runs the module's code, so a module
    is imported only if `scenario.allow_import` is True. Raise `InvalidScenario` if the import is not allowed,
    or if the class is missing, is no term or limit, or rejects the values.
    """
    title = f"[[{kind}]] {number} use = '{values['use']}'"
    arguments = {key: value for key, value in values.items() if key != "use"}
    try:
        if ":" not in values["use"]:
            return _called(title, PACKAGED[kind][values["use"]], radians(arguments))
        return _own(scenario, kind, title, values["use"], arguments)
    except FfsmsError as error:
        raise InvalidScenario(scenario.source, str(error)) from error.__cause__


def _own(scenario: Scenario, kind: str, title: str, use: str, arguments: Mapping[str, Any]) -> Any:
    """Make a term or limit of a user's own class."""
    part = own_class(title, use, scenario.source.parent, scenario.allow_import)
    if not (isinstance(part, type) and issubclass(part, _KINDS[kind])):
        raise FfsmsError(f"{title} is no subclass of opt.{_KINDS[kind].__name__}")
    made = _called(title, part, arguments)
    if not (isinstance(getattr(made, "name", None), str) and made.name):
        raise FfsmsError(f"{title} has no `name`; add an attribute `name`, a text, to the class")
    return made


def _called(title: str, part: Any, arguments: Mapping[str, Any]) -> Any:
    """Make a term or limit of the class `part`; raise `FfsmsError` if the class rejects the arguments."""
    signature = inspect.signature(part)
    try:
        signature.bind(**arguments)
    except TypeError as error:
        known = ", ".join(name for name in signature.parameters if not name.startswith("_"))
        problem = re.sub(r"(keyword-only |keyword )?argument", "key", str(error))
        raise FfsmsError(f"{title}: {problem} (its keys: {known or 'none'})") from None
    try:
        return part(**arguments)
    except FfsmsError as error:
        raise FfsmsError(f"{title}: {error}") from None
    except Exception as error:  # user code may raise any exception
        raise FfsmsError(f"{title} rejects the values of its keys ({in_one_line(error)})") from error
