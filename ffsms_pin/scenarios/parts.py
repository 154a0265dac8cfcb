"""Terms and limits of a scenario file, of [[term]] and [[limit]].

Each is one of the library's by a short name, or a user's own by an import path.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import sys
from collections.abc import Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import ConfigDict, Discriminator, Tag, WithJsonSchema, create_model

from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidScenario
from ffsms_pin.opt.problem import default_limits, default_terms
from ffsms_pin.options import Text
from ffsms_pin.scenarios.keys import *

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

_KINDS: Mapping[str, type] = {"term": opt.Term, "limit": opt.Limit}
_IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")

OWN = "package.module:Class"


class OwnPart(Keys):
    """A class of the user's own; the other keys are its keyword arguments."""

    model_config = ConfigDict(extra="allow")

    use: Annotated[Text, WithJsonSchema({"type": "string", "pattern": ":"})] = key(
        "", "", f'a class of your own, as "{OWN}"', required=True
    )


# By their names in a file: class, and what it is. Keys are the fields of the class.
_OURS: Mapping[str, Mapping[str, tuple[Any, str]]] = {
    "term": {
        "coupling": (opt.Coupling, "the paper's cost; there by default"),
        "smooth": (opt.Smooth, "small joint accelerations; there by default"),
        "effort": (opt.Effort, "little joint travel; there by default"),
        "base-turn": (opt.BaseTurn, "little turning of the base"),
        "wheel-momentum": (opt.WheelMomentum, "where wheels hold the base: little spin momentum"),
        "wheel-energy": (opt.WheelEnergy, "where wheels hold the base: little energy"),
        "propellant": (opt.Propellant, "where thrusters hold the base: little propellant"),
    },
    "limit": {
        "joints": (opt.JointLimits, "the joints' limits, of [limits]; there by default"),
        "clearance": (opt.Clearance, "a clearance; there by default"),
        "base": (opt.BaseLimits, "how far and how fast the base may move"),
        "alpha-box": (opt.AlphaBox, "the paper's box of alpha, for whole motions too"),
        "torques": (opt.TorqueLimits, "the joints' torques; there by default"),
        "wheels": (opt.WheelLimits, "the wheels' torque and momentum; there where they hold the base"),
    },
}


def _table(use: str, made: Any, what: str) -> Any:
    """Return the table of one of our terms or limits."""
    chosen: Any = {"use": (Literal[use], key("", "", what, required=True))}
    return table_of(made, base=create_model(made.__name__, __base__=MadeKeys, __doc__=made.__doc__, **chosen))


PACKAGED: Mapping[str, Mapping[str, type]] = {
    kind: {use: made for use, (made, *_) in rows.items()} for kind, rows in _OURS.items()
}
"""The library's own terms and limits by their names in a scenario file."""

PARTS: Mapping[str, Mapping[str, type[Keys]]] = {
    kind: {**{use: _table(use, *row) for use, row in rows.items()}, "own": OwnPart}
    for kind, rows in _OURS.items()
}
"""The tables [[term]] and [[limit]] by their `use`; "own" is a class of the user's."""


def _which(row: Any) -> str:
    """Return the name of a row's table: one of the library's by its `use`, else "own"."""
    use = row.get("use") if isinstance(row, Mapping) else getattr(row, "use", None)
    return use if isinstance(use, str) and use.strip() and ":" not in use else "own"


def _either(tables: Mapping[str, type[Keys]]) -> Any:
    """Return the union of several tables, chosen by `use`."""
    tagged = tuple(Annotated[table, Tag(use)] for use, table in tables.items())
    return Annotated[Union[tagged], Discriminator(_which)]  # noqa: UP007


TermTable: Any = _either(PARTS["term"])
LimitTable: Any = _either(PARTS["limit"])


def terms(scenario: Scenario, goal: opt.Goal) -> list[opt.Term]:
    """Return the terms: those by default, by keys of [plan], and of [[term]]."""
    plan = scenario.plan
    coupled = goal.coupled or "kappa" in plan
    chosen = {key: plan[key] for key in ("kappa", "effort", "base") if key in plan}
    defaults = default_terms(**chosen, coupled=coupled)
    return _with_rows(scenario, "term", defaults)


def limits(scenario: Scenario, client: Any) -> list[opt.Limit]:
    """Return the limits: those by default, by keys of [plan], and of [[limit]]; of a `client`, if any."""
    base = scenario.plan.get("base_limits")
    limits = None if base is None else opt.BaseLimits(**radians(base))
    defaults = default_limits(*scenario.clearance, scenario.obstacles(client), limits)
    return _with_rows(scenario, "limit", defaults)


def _with_rows(scenario: Scenario, kind: str, defaults: tuple[Any, ...]) -> list[Any]:
    """Return terms or limits with those of [[kind]], which replace others of the same name."""
    ours = {part.name: part for part in defaults}
    more = [
        # The clearance between the same bodies and obstacles, as `Scenario.clearance` reads it.
        ours["clearance"] if row["use"] == "clearance" else _made_part(scenario, kind, i, row)
        for i, row in enumerate(getattr(scenario, kind), start=1)
    ]
    names = [part.name for part in more]
    return [part for part in defaults if part.name not in names] + more


def _made_part(scenario: Scenario, kind: str, number: int, values: Mapping[str, Any]) -> Any:
    """Make a term or limit of a file: the row `number` of [[kind]], from 1.

    Modules of a user's own are looked for in the file's folder first, and imported, which runs their code,
    only where the scenario allows it. `InvalidScenario`: the class is not there, is no term or limit, does
    not take the values, or may not be imported.
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
            f"{title} would run the code of that module: allow it, if you trust it, with allow_import=True",
        )
    part = _imported(source, title, use)
    if not (isinstance(part, type) and issubclass(part, _KINDS[kind])):
        raise InvalidScenario(source, f"{title} is no subclass of opt.{_KINDS[kind].__name__}")
    made = _called(source, title, part, arguments)
    if not (isinstance(getattr(made, "name", None), str) and made.name):
        raise InvalidScenario(source, f"{title} has no `name`: give the class one, a text")
    return made


def _imported(source: Path, title: str, use: str) -> Any:
    """Import an object by its path, with the file's folder first on sys.path."""
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
        raise InvalidScenario(source, f"{title}: {error}") from None
    except Exception as error:  # whatever the user's code raises
        raise InvalidScenario(source, f"{title} cannot be made of these values ({_line(error)})") from error


def _line(error: Exception) -> str:
    """Return an error of a user's code in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
