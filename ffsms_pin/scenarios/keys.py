"""Pydantic models of the tables of a scenario file: keys with their units, defaults and descriptions.

A key is a field made by `key` or `angle`, or an option of the library (`table_of`, `tables_by`). The checks,
the JSON Schema and the page of the documentation are made from the models. A key that a file leaves out is
absent from the values of the file, so that the library's default applies.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import re
import sys
import textwrap
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Union, get_args, get_type_hints

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PrivateAttr,
    Tag,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from ffsms_pin.options import Angle, Kind, Unit, unusable

DEGREES = "_deg"  # ending of the keys that give an angle in degrees


def key(
    unit: str, default: str, what: str | None = None, *, required: bool = False, degrees: bool = False
) -> Any:
    """Return the field of a key, from its unit and its default as text.

    The description is `what`, or else the docstring below the field. A file must have a `required` key. With
    `degrees` a file may also use the key's name with `_deg`.
    """
    more: dict[str, Any] = {"unit": unit, "default_in_words": default, "degrees": degrees}
    return Field(... if required else None, description=what, json_schema_extra=more)


def angle(unit: str, default: str, what: str | None = None, *, required: bool = False) -> Any:
    """Return the field of a key that a file may also give in degrees."""
    return key(unit, default, what, required=required, degrees=True)


def table() -> Any:
    """Return the field of a nested table."""
    return Field(None)


def description(field: FieldInfo) -> str:
    """Return the description of a key in one line."""
    return " ".join((field.description or "").split()).rstrip(".")


def about(field: FieldInfo) -> Mapping[str, Any]:
    """Return the unit, the default as text, and True if degrees are allowed; empty for a nested table."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


class Keys(BaseModel):
    """A table, which rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

    # The key that chooses one table of `choices`, to which this table belongs; set by `tables_by`.
    chooser: ClassVar[str] = ""
    choices: ClassVar[Mapping[str, type[Keys]]] = {}

    _in_degrees: frozenset[str] = PrivateAttr(frozenset())

    @model_validator(mode="wrap")
    @classmethod
    def _take_degrees(cls, content: Any, handler: ModelWrapValidatorHandler[Keys]) -> Keys:
        """Read `joints_deg` as `joints`; its value stays in degrees, and `_in_degrees` records the key."""
        if not isinstance(content, Mapping):
            return handler(content)
        turned = frozenset(name for name in cls.angle_keys() if name + DEGREES in content)
        for name in turned:
            if name in content:
                raise unusable(f"has both {name} and {name}{DEGREES}; keep one")
        renamed = {name + DEGREES: name for name in turned}
        model = handler({renamed.get(name, name): value for name, value in content.items()})
        model._in_degrees = turned
        return model

    @classmethod
    def angle_keys(cls) -> list[str]:
        """Return the keys that a file may also give in degrees."""
        return [name for name, field in cls.model_fields.items() if about(field).get("degrees")]

    @classmethod
    def allowed_keys(cls) -> list[str]:
        """Return the keys as a file may write them: angles with and without `_deg`."""
        return [*cls.model_fields, *(name + DEGREES for name in cls.angle_keys())]

    @classmethod
    def chosen_keys(cls) -> list[str]:
        """Return the keys that some of the `choices` lack."""
        others = [table.model_fields for table in cls.choices.values() if table.chooser]
        return [name for name in cls.model_fields if any(name not in fields for fields in others)]

    def given_values(self) -> dict[str, Any]:
        """Return the values of the file by key as typed: angles in degrees have keys with `_deg`."""
        values: dict[str, Any] = {}
        for name in type(self).model_fields:
            if name in self.model_fields_set:
                values[name + DEGREES * (name in self._in_degrees)] = frozen(getattr(self, name))
        return values | {name: frozen(value) for name, value in (self.model_extra or {}).items()}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the JSON Schema, which has a second key for each angle, in degrees."""
        reference = handler(core_schema)
        schema = handler.resolve_ref_schema(reference)
        for name, field in cls.model_fields.items():
            if field.description:
                schema["properties"][name]["description"] = description(field)
            if about(field).get("degrees"):
                twin = {**schema["properties"][name], "unit": "deg", "degrees": False}
                schema["properties"][name + DEGREES] = twin
                if name in (required := schema.get("required", [])):
                    required.remove(name)
                    schema.setdefault("allOf", []).append(
                        {"anyOf": [{"required": [name]}, {"required": [name + DEGREES]}]}
                    )
        return reference


def models_in(annotation: Any) -> list[type[Keys]]:
    """Return the tables in an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, Keys):
        return [annotation]
    return [model for inner in get_args(annotation) for model in models_in(inner)]


class Option(NamedTuple):
    """A field or parameter of the library that is a key of a table; a required one has the default None."""

    kind: Any
    unit: Unit
    default: str | None
    what: str

    @property
    def key(self) -> tuple[Any, Any]:
        """The type and the `key` of a field in a table."""
        required, degrees = self.default is None, isinstance(self.unit, Angle)
        return self.kind, key(
            self.unit.name, self.default or "", self.what, required=required, degrees=degrees
        )


@cache
def options_of(source: Any) -> dict[str, Option]:
    """Return the fields of a dataclass, or the parameters of a class or function, whose type has a `Unit`."""
    what, options = descriptions(source), {}
    for name, parameter in inspect.signature(source).parameters.items():
        if not str(parameter.annotation).startswith("Annotated["):
            continue
        hint = _hint(source, parameter)
        parts = _metadata(hint)
        unit = next((part for part in parts if isinstance(part, Unit)), None)
        if unit is None:
            continue
        kind = next((Annotated[Any, part] for part in parts if isinstance(part, Kind)), get_args(hint)[0])
        required = parameter.default is parameter.empty
        default = None if required else unit.default or in_words(parameter.default)
        options[name] = Option(kind, unit, default, what.get(name, ""))
    return options


class MadeKeys(Keys):
    """The base of tables made at import time, whose keys have no docstrings in the source."""

    model_config = ConfigDict(use_attribute_docstrings=False)


OWN = "package.module:Class"  # the name under which a user's own classes stand among the choices


def table_of(
    *sources: Any,
    base: type[Keys] = MadeKeys,
    omit: Collection[str] = (),
    defaults: Mapping[str, str] | None = None,
) -> Any:
    """Return a table whose keys are the options of classes or functions of the library.

    Parameters
    ----------
    *sources : class or function
    base : type, optional
        A table with further keys, which also sets name and docstring. Default: those of the first source.
    omit : collection of str
        Options without a key.
    defaults : mapping, optional
        Defaults as text, by key, that differ from the library's in a file; these keys are optional.
    """
    named = sources[0] if base is MadeKeys else base
    title = (inspect.getdoc(named) or "").partition("\n")[0]
    return _table(named.__name__, title, base, _keys(sources, base, omit, defaults or {}))


def tables_by(
    chooser: str,
    base: type[Keys],
    choices: Mapping[str, Any],
    *shared: Any,
    bases: Mapping[str, type[Keys]] | None = None,
    omit: Collection[str] = (),
    defaults: Mapping[str, str] | None = None,
    own: type[Keys] | None = None,
) -> dict[str, type[Keys]]:
    """Return a table for each value of a key, such as the laws of [control].

    Parameters
    ----------
    chooser : str
        The key, such as "law".
    base : type
        The table with this key.
    choices : mapping
        By value, a class or function whose options are further keys, or None.
    *shared : class or function
        Sources of further keys of all tables.
    bases : mapping, optional
        Tables that replace `base`, by value.
    omit, defaults
        As in `table_of`.
    own : type, optional
        The table of a user's own class, whose value of the key is an import path.
    """
    tables: dict[str, type[Keys]] = {}
    for choice, source in choices.items():
        chosen_base = (bases or {}).get(choice, base)
        sources = shared if source is None else (source, *shared)
        field = chosen_base.model_fields[chooser]
        default = about(field)["default_in_words"]
        chosen = key("", default, field.description, required=default != f'"{choice}"')
        keys = {chooser: (Literal[choice], chosen), **_keys(sources, chosen_base, omit, defaults or {})}
        title = (inspect.getdoc(source or base) or "").partition("\n")[0]
        tables[choice] = _table(f"{chosen_base.__name__}.{choice}", title, chosen_base, keys)
    for table in tables.values():
        table.chooser, table.choices = chooser, tables
    if own is not None:
        tables[OWN] = own
    return tables


def union_of(tables: Mapping[str, type[Keys]]) -> Any:
    """Return the union of tables made by `tables_by`; a key of the file's table chooses the model."""
    chooser = next(iter(tables.values())).chooser
    default = [name for name, table in tables.items() if not table.model_fields[chooser].is_required()]

    def chosen(row: Any) -> str | None:
        """Return the value of the chooser in a file's table; None if it is missing and has no default."""
        value = row.get(chooser) if isinstance(row, Mapping) else next(iter(tables))
        if value is None:
            return next(iter(default), None)
        return OWN if OWN in tables and ":" in str(value) else str(value)

    tagged = tuple(Annotated[table, Tag(choice)] for choice, table in tables.items())
    return Annotated[Union[tagged], Discriminator(chosen)]  # noqa: UP007


def by_name(parts: Iterable[Any]) -> dict[str, Any]:
    """Return terms or limits of the library by their names in a scenario file."""
    return {part.name.replace(" ", "-"): part for part in parts}


def file_of(tables: Mapping[str, Any], name: str, required: Collection[str]) -> type[Keys]:
    """Return the model of a file with these tables.

    An absent table that is `required` is read as an empty one, whose missing keys are then reported.
    """
    fields: dict[str, Any] = {
        title: (kind, Field({}, validate_default=True) if title in required else table())
        for title, kind in tables.items()
    }
    return create_model(name, __base__=MadeKeys, **fields)


def _keys(
    sources: Iterable[Any], base: type[Keys], omit: Collection[str], defaults: Mapping[str, str]
) -> dict[str, Any]:
    """Return the options of classes or functions as keys, except for the keys of `base`."""
    options = {name: option for source in sources for name, option in options_of(source).items()}
    return {
        name: option._replace(default=defaults.get(name, option.default)).key
        for name, option in options.items()
        if name not in base.model_fields and name not in omit
    }


def _table(name: str, title: str, base: type[Keys], keys: Mapping[str, Any]) -> Any:
    """Return the table with the keys of `base` and further keys."""
    bases = MadeKeys if issubclass(base, MadeKeys) else (base, MadeKeys)
    return create_model(name, __base__=bases, __doc__=title, **keys)


def _hint(source: Any, parameter: inspect.Parameter) -> Any:
    """Return the type of a parameter with its metadata.

    Other annotations are not evaluated, because they may name types that are imported for type checking only.
    """
    space, name = getattr(source, "__globals__", None), parameter.name
    for kind in reversed(source.__mro__) if isinstance(source, type) else ():
        if name in vars(kind).get("__annotations__", {}):  # a field of a dataclass
            space = vars(sys.modules[kind.__module__])
    if space is None:
        space = source.__init__.__globals__
    annotation = SimpleNamespace(__annotations__={name: parameter.annotation})
    return get_type_hints(annotation, space, include_extras=True)[name]


def _metadata(hint: Any) -> list[Any]:
    """Return the metadata of a type hint and of its parts."""
    inner = [part for argument in get_args(hint) for part in _metadata(argument)]
    return [*getattr(hint, "__metadata__", ()), *inner]


_SECTION = re.compile(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}$|\Z)", re.M | re.S)
_ENTRY = re.compile(r"^(\S.*)\n((?:[ ]+\S.*\n?|\n)*)", re.M)
_BRACKETS = re.compile(r" ?\[(?:rad|m|N|kg|s|1/s)\b[^\]]*\]")  # units, which have their own column


def descriptions(source: Any) -> dict[str, str]:
    """Return the descriptions of fields and parameters, from docstrings below them or from NumPy sections."""
    texts: dict[str, str] = {}
    for kind in reversed(source.__mro__[:-1]) if isinstance(source, type) else (source,):
        for section in _SECTION.findall(inspect.cleandoc(kind.__doc__ or "")):
            for names, text in _ENTRY.findall(section):
                texts |= dict.fromkeys(names.partition(" :")[0].split(", "), _BRACKETS.sub("", text))
        if dataclasses.is_dataclass(kind):
            texts |= _below_fields(kind)
    return texts


def _below_fields(kind: Any) -> dict[str, str]:
    """Return the docstrings below the fields of a class."""
    docstrings: dict[str, str] = {}
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    for field, below in pairwise(tree.body if isinstance(tree, ast.ClassDef) else []):
        named = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if named and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            docstrings[field.target.id] = str(below.value.value)  # type: ignore[attr-defined]
    return docstrings


def in_words(default: Any) -> str:
    """Return a default as text for the documentation."""
    if isinstance(default, bool):
        return "true" if default else "false"
    if isinstance(default, (int, float)):
        return f"{default:g}"
    if isinstance(default, tuple):
        return f"[{', '.join(map(in_words, default))}]"
    return "" if default is None else f'"{default}"'


def frozen(value: Any) -> Any:
    """Return a value with lists as tuples and tables as dicts."""
    if isinstance(value, Keys):
        return value.given_values()
    if isinstance(value, list | tuple):
        return tuple(frozen(item) for item in value)
    return {name: frozen(item) for name, item in value.items()} if isinstance(value, dict) else value


def radians(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values in radians, under their names without `_deg`."""
    return {
        name.removesuffix(DEGREES): _radians(value) if name.endswith(DEGREES) else value
        for name, value in values.items()
    }


def _radians(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: math.radians(angle) for name, angle in value.items()}
    return tuple(map(math.radians, value)) if isinstance(value, tuple) else math.radians(value)
