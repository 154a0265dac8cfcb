"""Scenario files: those that ship with the library, their one model, and what is wrong with a file."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from ffsms_pin.checks import SMALLEST_POSITIVE
from ffsms_pin.errors import InvalidScenario, meant, short
from ffsms_pin.files import read_content
from ffsms_pin.scenarios.fits import check_fits
from ffsms_pin.scenarios.keys import DEGREES, Keys, about, models_in
from ffsms_pin.scenarios.tables import NONE_IF_ABSENT, OWN, PARTS, ScenarioFile

_SYNONYMS = {"goal": "target", "waypoint": "via", "noise": "sensors", "controller": "control"}


def scenario_names() -> list[str]:
    """Return the names of the scenarios that ship with the library."""
    return sorted(file.stem for file in Path(__file__).parent.glob("*.toml"))


def packaged_path(name: str) -> Path:
    """Return the file of a scenario that ships with the library."""
    return Path(__file__).with_name(f"{name}.toml")


def read(source: Path) -> dict[str, Any]:
    """Read a TOML file; `InvalidScenario` if it is missing, cannot be read, or is not TOML."""
    try:
        return tomllib.loads(read_content(source).decode("utf-8-sig"))
    except (FileNotFoundError, NotADirectoryError):
        packaged = scenario_names()
        raise InvalidScenario(
            source,
            f"there is no such file, nor a packaged scenario of that name ({', '.join(packaged)})"
            + meant(source, packaged, "; "),
        ) from None
    except OSError as error:
        raise InvalidScenario(source, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InvalidScenario(source, "is not a TOML file (not UTF-8 text)") from None
    except (ValueError, RecursionError) as error:  # also a path with a null character
        raise InvalidScenario(source, f"is not a TOML file ({error})") from None


def schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario file, with which editors complete keys and show their units."""
    fields = ScenarioFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **fields}


def checked_tables(source: Path, content: Mapping[str, Any]) -> dict[str, Any]:
    """Check the tables of a scenario and return them.

    `InvalidScenario` names one that is not. A table that is left out is empty, or None where that is another
    thing than an empty one.
    """
    if "watchdog" in content and "guards" not in content:  # the former name of the table
        content = {"guards" if name == "watchdog" else name: value for name, value in content.items()}
    try:
        typed = ScenarioFile.model_validate(content).given_values()
    except ValidationError as error:
        # A misspelt key comes first, what is missing for that very reason last.
        order = {"extra_forbidden": 0, "missing": 2}
        first = min(error.errors(include_url=False), key=lambda fault: order.get(fault["type"], 1))
        raise InvalidScenario(source, _in_words(first, content)) from None
    tables: dict[str, Any] = {}
    for name, field in ScenarioFile.model_fields.items():
        absent: Any = () if get_origin(field.annotation) is list else None if name in NONE_IF_ABSENT else {}
        tables[name] = typed.get(name, absent)
    check_fits(source, tables)
    return tables


def _in_words(error: ErrorDetails, content: Mapping[str, Any]) -> str:
    """Return an error of a file in one line: table, key, fault and value."""
    kind, value = error["type"], error["input"]
    title, name, model, values = _place(error["loc"], content)
    if kind == "extra_forbidden":
        fields = model.model_fields
        known = list(fields)
        if model is ScenarioFile:
            return f"unknown table [{name}]; {_suggestion(name, known)}"
        known += [word + DEGREES for word, field in fields.items() if about(field).get("degrees")]
        return f"unknown key '{name}' in {title}; {_suggestion(name, known)}"
    if kind == "missing":
        return f"{title} {name} is missing; it has no default"
    if kind == "union_tag_invalid":
        table = str(error["loc"][0])
        use, known = str(values.get("use")), [part for part in PARTS[table] if part != "own"]
        return (
            f"{title} use = '{use}' is no {table} of ours; {_suggestion(use, known)}; yours is written {OWN}"
        )
    if not name and kind in ("model_type", "model_attributes_type", "list_type"):
        path = ".".join(str(step) for step in error["loc"] if isinstance(step, str))
        if title.startswith("[["):
            return f"'{path}' may be there several times: write [[{path}]] and its keys below"
        return f"'{path}' must be a table: write [{path}] and its keys below it"
    if not name:
        return f"{title} {_wrong(error)}"
    typed = name + DEGREES if name + DEGREES in values else name
    return f"{title} {typed} {_wrong(error)}, got {short(value)}"


def _place(where: tuple[int | str, ...], content: Any) -> tuple[str, str, type[Keys], Any]:
    """Return the title of an error's table, the key (empty: the table itself), its model, and its values."""
    model: type[Keys] = ScenarioFile
    title, path, values = "", "", content
    steps = list(where)
    while steps:
        name = str(steps.pop(0))
        fields = model.model_fields
        kinds = models_in(fields[name].annotation) if name in fields else []
        if not kinds:
            return title, name, model, values
        path = f"{path}.{name}" if path else name
        title, model = f"[{path}]", kinds[0]
        values = values.get(name, {}) if isinstance(values, Mapping) else {}
        if get_origin(fields[name].annotation) is list:
            title = f"[[{path}]]"
            if steps:
                i = int(steps.pop(0))
                title, values = f"[[{path}]] {i + 1}", values[i]
            if steps and name in PARTS:
                use = str(steps.pop(0))
                model = PARTS[name].get(use, kinds[0])
    return title, "", model, values


def _wrong(error: ErrorDetails) -> str:
    """Return the fault of a value in the words of this library."""
    kind, limits = error["type"], error.get("ctx", {})
    if kind in ("greater_than_equal", "less_than_equal"):
        return _out_of_range(error["input"], limits)
    if kind == "literal_error":
        choices = str(limits["expected"]).replace(" or ", ", ").replace("'", '"')
        return f"must be one of {choices}"
    messages = {
        "float_type": "must be a number",
        "finite_number": "must be finite",
        "int_type": "must be a whole number",
        "bool_type": "must be true or false",
        "string_type": "must be a text that is not empty",
        "list_type": "must be a list",
        "dict_type": "must be a table",
    }
    if kind == "float_type" and isinstance(error["input"], int) and not isinstance(error["input"], bool):
        return "is too large"
    return messages.get(kind, str(error["msg"]))


def _out_of_range(value: Any, limits: Mapping[str, Any]) -> str:
    """Return the bound that a number violates."""
    least = limits.get("ge")
    if isinstance(value, float) and math.isnan(value):
        return "must be finite"
    if least is None:
        return f"must be at most {limits['le']:g}"
    if isinstance(least, int):
        return f"must be a whole number of at least {least}"
    if least == SMALLEST_POSITIVE:
        return "must be above zero" if value <= 0.0 else f"must be at least {least:g}"
    return "must not be negative" if least == 0.0 else f"must be at least {least:g}"


def _suggestion(word: str, allowed: Collection[str]) -> str:
    synonym = _SYNONYMS.get(word)
    guess = f"did you mean '{synonym}'?" if synonym in allowed else meant(word, allowed)
    return f"{guess} (allowed: {', '.join(sorted(allowed))})".lstrip()
