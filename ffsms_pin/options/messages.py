"""Messages about wrong keys and values of a file, for errors of pydantic and of the library."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, get_origin

from pydantic import ValidationError

from ffsms_pin import errors
from ffsms_pin.errors import meant, short
from ffsms_pin.options.tables import DEGREES, Keys, about, models_in, table_at

LOADING = errors.ModelNotFound, errors.FrameNotFound, errors.InvalidUrdf, errors.AmbiguousEndEffector
"""Errors of `ffsms_pin.load` that name no argument."""

_IN_A_FILE = "[robot] {key} = {listed}"  # replaces "load(..., key=VALUE)" in messages of the library
_REQUIREMENTS = {"bool_type": "must be true or false", "dict_type": "must be a table"}
_WHOLE = ("model_type", "model_attributes_type", "list_type")  # types of errors if a table is expected


def message_of_check(
    error: ValidationError, model: type[Keys], content: Mapping[str, Any], synonyms: Mapping[str, str]
) -> str:
    """Return the message for the first error of a file in one line: table, key, requirement and value.

    Errors of misspelt keys come before errors of missing keys, because a misspelling also makes a key
    missing. `model` is the model of the file, and `content` the file's content. `synonyms` maps wrong names
    of tables that users may write to the right names.
    """
    order = {"extra_forbidden": 0, "missing": 2}
    first = min(error.errors(include_url=False), key=lambda fault: order.get(fault["type"], 1))
    kind, value = first["type"], first["input"]
    title, name, table, values = _place(first["loc"], model, content)
    if kind == "extra_forbidden":
        if table is model:
            return f"unknown table [{name}]; {_suggestion(name, list(model.model_fields), synonyms)}"
        return _unknown(title, name, table)
    if kind == "missing":
        needed = f": {_choice(table)} needs it" if name in table.chosen_keys() else "; it has no default"
        return f"{title} {name} is missing{needed}"
    if kind == "union_tag_not_found":
        return f"{title} {table.chooser} is missing; it has no default"
    if kind == "union_tag_invalid":
        choices, value = ", ".join(f'"{choice}"' for choice in table.choices), values[table.chooser]
        guess = meant(str(value), table.choices, "; ")
        return f"{title} {table.chooser} must be one of {choices}{guess}, got {short(value)}"
    if not name and kind in _WHOLE:
        path = title.partition(" ")[0].strip("[]")
        if title.startswith("[["):
            return f"'{path}' may occur several times: write [[{path}]] and its keys below"
        return f"'{path}' must be a table: write [{path}] and its keys below it"
    requirement = _REQUIREMENTS.get(kind, first["msg"])
    if kind == "literal_error":
        choices = first["ctx"]["expected"].replace(" or ", ", ").replace("'", '"')
        requirement = f"must be one of {choices}"
    if not name:
        return f"{title} {requirement}"
    unit = about(table.model_fields[name])["unit"]
    if name + DEGREES in values:
        unit, name = unit.replace("rad", "deg"), name + DEGREES
    return f"{title} {name} {requirement}{f' [{unit}]' if unit else ''}, got {short(value)}"


def _unknown(title: str, name: str, table: type[Keys]) -> str:
    """Return the message for an unknown key, with another choice of the table that has the key, if any."""
    tables = table.choices.items()
    takers = [choice for choice, other in tables if name.removesuffix(DEGREES) in other.model_fields]
    if not takers:
        others = [key for _, other in tables for key in other.allowed_keys()]
        return f"unknown key '{name}' in {title}; {_suggestion(name, table.allowed_keys(), {}, others)}"
    own = ", ".join(table.chosen_keys())
    takes = f", which takes {own}" if own else ""
    return f'{title} {name} is no option of {_choice(table)}{takes}; {table.chooser} = "{takers[0]}" takes it'


def _place(where: tuple[int | str, ...], model: type[Keys], values: Any) -> tuple[str, str, type[Keys], Any]:
    """Return the title of the table with an error, the key, and the table's model and values.

    The key is empty if the error concerns the whole table.
    """
    title, path, steps = "", "", list(where)
    while steps:
        name = str(steps.pop(0))
        field = model.model_fields.get(name)
        tables = [] if field is None else models_in(field.annotation)
        if field is None or not tables:
            return title, name, model, values
        path = f"{path}.{name}" if path else name
        title, model = f"[{path}]", tables[0]
        values = values.get(name, {}) if isinstance(values, Mapping) else {}
        if get_origin(field.annotation) is list:
            title = f"[[{path}]]"
            if steps:
                i = int(steps.pop(0))
                title, values = f"[[{path}]] {i + 1}", values[i]
        if steps and model.choices:
            model = model.choices[str(steps.pop(0))]
    return title, "", model, values


def _choice(table: type[Keys]) -> str:
    """Return a text of the key and value that select a table, such as `law = "pd"`."""
    (choice,) = (choice for choice, other in table.choices.items() if other is table)
    return f'{table.chooser} = "{choice}"'


def _suggestion(
    word: str, allowed: Collection[str], synonyms: Mapping[str, str], others: Collection[str] = ()
) -> str:
    """Return the allowed names as text, after a question with a similar or synonymous name if there is one.

    `others` are keys that the table allows with another choice; the question may name one of them, too.
    """
    synonym = synonyms.get(word)
    guess = f"did you mean '{synonym}'?" if synonym in allowed else meant(word, [*allowed, *others])
    return f"{guess} (allowed: {', '.join(sorted(allowed))})".lstrip()


def is_table(model: type[Keys], path: str) -> bool:
    """Return whether a key of a file with this model, such as "attitude.dump", is a table."""
    for step in path.split("."):
        field = model.model_fields.get(step)
        tables = [] if field is None else models_in(field.annotation)
        if not tables:
            return False
        model = tables[0]
    return True


def message_of_value(
    error: errors.InvalidValue, model: type[Keys], tables: Mapping[str, Any], paths: tuple[str, ...]
) -> str:
    """Return the message of a library error; if a table has the key, it replaces the argument's name.

    `paths` are the tables that were read, as in `table_at`. The message names the first table with the key.
    """
    message = errors.advised(str(error), _IN_A_FILE)
    wrong = message.removeprefix(error.name).rpartition(", got ")[0]
    prefix, _, name = error.name.replace(" ", ".").rpartition(".")
    name, entry, _ = name.partition("[")  # the entry "size[0]" belongs to the key "size"
    if isinstance(tables.get(prefix), Mapping):
        paths = (prefix, *paths)
    for path in paths:
        title, table = table_at(tables, path)
        if name in table and is_table(model, f"{path}.{name}"):  # the argument is a whole table
            return f"[{path}.{name}]{wrong}, got {short(error.value)}"
        if isinstance(inner := table.get(prefix), Mapping):
            title, table = f"[{path}.{prefix}]", inner
        for key in (name, name + DEGREES):
            if key in table:
                wrong = wrong.replace(" [rad]", "") if key.endswith(DEGREES) else wrong
                narrower = entry or (isinstance(error.value, str) and not isinstance(table[key], str))
                return f"{title} {key}{wrong}, got {short(error.value if narrower else table[key])}"
    if isinstance(tables.get(prefix), Mapping):
        return f"[{prefix}] {name}{message.removeprefix(error.name)}"
    title = f"{table_at(tables, paths[0])[0]} " if len(paths) == 1 and "[" not in error.name else ""
    return f"{title}{message}"


def message_of_loading(error: Exception, tables: Mapping[str, Any], paths: tuple[str, ...]) -> str:
    """Return the message of a `LOADING` error with the title of the first table and the key, if known."""
    title, table = table_at(tables, paths[0]) if paths else ("", {})
    keys = ("end_effector", "frame") if isinstance(error, errors.FrameNotFound) else ("model",)
    unclear = isinstance(error, errors.AmbiguousEndEffector | errors.InvalidUrdf)
    key = next((f" {key}:" for key in keys if key in table), "") if not unclear else ""
    return f"{title}{key} {errors.advised(str(error), _IN_A_FILE)}".lstrip()
