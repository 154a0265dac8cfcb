"""Tables of a scenario file as models: keys with units, defaults, and degrees.

Every key is a field made by `key` or `angle`; the page of the documentation, the JSON Schema and the checks
follow from it. A key that a file leaves out is left out of the model, too: the library's defaults apply.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import sys
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING
from itertools import pairwise
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PrivateAttr,
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
    """Return a key of a table: its unit, its default in words, and its description (or a docstring).

    It has to be there if `required`; with `degrees` it may be given under its name with `_deg` as well.
    """
    more: dict[str, Any] = {"unit": unit, "default_in_words": default, "degrees": degrees}
    return Field(... if required else None, description=what, json_schema_extra=more)


def angle(unit: str, default: str, what: str | None = None, *, required: bool = False) -> Any:
    """Return a key that may be given in degrees as well."""
    return key(unit, default, what, required=required, degrees=True)


def table() -> Any:
    """Return the key of a table inside a table."""
    return Field(None)


def words(field: FieldInfo) -> str:
    """Return the description of a key in one line."""
    return " ".join((field.description or "").split()).rstrip(".")


def about(field: FieldInfo) -> Mapping[str, Any]:
    """Return unit, default in words, and whether degrees are taken; empty for a table."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


class Keys(BaseModel):
    """A table; what is no field of it is refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

    _in_degrees: frozenset[str] = PrivateAttr(frozenset())

    @model_validator(mode="wrap")
    @classmethod
    def _take_degrees(cls, content: Any, handler: ModelWrapValidatorHandler[Keys]) -> Keys:
        """Read `joints_deg` as `joints`, and remember it: the number stays the file's."""
        if not isinstance(content, Mapping):
            return handler(content)
        angles = [name for name, field in cls.model_fields.items() if about(field).get("degrees")]
        turned = frozenset(name for name in angles if name + DEGREES in content)
        for name in turned:
            if name in content:
                raise unusable(f"has both {name} and {name}{DEGREES}; keep one")
        renamed = {name + DEGREES: name for name in turned}
        model = handler({renamed.get(name, name): value for name, value in content.items()})
        model._in_degrees = turned
        return model

    def given_values(self) -> dict[str, Any]:
        """Return the values of the file, by key; angles in degrees under their names with `_deg`."""
        values: dict[str, Any] = {}
        for name in type(self).model_fields:
            if name in self.model_fields_set:
                values[name + DEGREES * (name in self._in_degrees)] = frozen(getattr(self, name))
        return values | {name: frozen(value) for name, value in (self.model_extra or {}).items()}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the JSON Schema with the keys in degrees, and descriptions in one line."""
        reference = handler(core_schema)
        schema = handler.resolve_ref_schema(reference)
        for name, field in cls.model_fields.items():
            if field.description:
                schema["properties"][name]["description"] = words(field)
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


class MadeKeys(Keys):
    """A table that is made when the module is loaded; no source has docstrings of its keys."""

    model_config = ConfigDict(use_attribute_docstrings=False)


def table_of(
    options: type, base: type[Keys] | None = None, defaults: Mapping[str, str] | None = None, **more: Any
) -> Any:
    """Return the table whose keys are the fields of a dataclass of options.

    Parameters
    ----------
    options : type
        A dataclass whose fields have a `Unit`; other fields are no keys.
    base : type, optional
        A table with further keys.
    defaults : mapping, optional
        Defaults in words, by key, that a file has in place of the dataclass.
    **more
        Further keys, each with its type and its `key`.
    """
    docstrings = attribute_docstrings(options)
    made: dict[str, Any] = {}
    for field in dataclasses.fields(options) if dataclasses.is_dataclass(options) else ():
        hint = _hint(options, field.name) if str(field.type).startswith("Annotated[") else None
        parts = _metadata(hint)
        unit = next((part for part in parts if isinstance(part, Unit)), None)
        if unit is None:
            continue
        kind = next((part for part in parts if isinstance(part, Kind)), None)
        required = field.default is MISSING and field.default_factory is MISSING
        made[field.name] = (
            get_args(hint)[0] if kind is None else Annotated[Any, kind],
            key(
                unit.name,
                "" if required else (defaults or {}).get(field.name, unit.default or in_words(field.default)),
                docstrings.get(field.name, ""),
                required=required,
                degrees=isinstance(unit, Angle),
            ),
        )
    bases = (MadeKeys,) if base is None else (base, MadeKeys)
    title = (inspect.getdoc(options) or "").partition("\n")[0]
    name = options.__name__ if base is None else base.__name__
    return create_model(name, __base__=bases, __doc__=title, **more | made)


def _hint(options: type, name: str) -> Any:
    """Return the type of a field with its metadata; other annotations of the class are not evaluated."""
    owner = next(kind for kind in options.__mro__ if name in vars(kind).get("__annotations__", {}))
    annotation = SimpleNamespace(__annotations__={name: owner.__annotations__[name]})
    return get_type_hints(annotation, vars(sys.modules[owner.__module__]), include_extras=True)[name]


def _metadata(hint: Any) -> list[Any]:
    """Return the metadata of a type hint, of its parts too."""
    inner = [part for argument in get_args(hint) for part in _metadata(argument)]
    return [*getattr(hint, "__metadata__", ()), *inner]


def attribute_docstrings(options: type) -> dict[str, str]:
    """Return the docstrings below the fields of a class, those of its bases too."""
    docstrings: dict[str, str] = {}
    for kind in reversed(options.__mro__[:-1]):
        if not dataclasses.is_dataclass(kind):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        body = tree.body if isinstance(tree, ast.ClassDef) else []
        for field, below in pairwise(body):
            named = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
            if named and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                docstrings[field.target.id] = str(below.value.value)  # type: ignore[attr-defined]
    return docstrings


def in_words(default: Any) -> str:
    """Return a default as the documentation shows it."""
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
