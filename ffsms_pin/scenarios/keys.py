"""A table of a scenario file as a model: its keys with units and defaults, angles in radians or degrees.

Every key is a field made by `key` or `angle`; the page of the documentation, the JSON Schema and the checks
follow from it. A key that a file leaves out is left out of the model, too: the library's defaults apply.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PrivateAttr,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from ffsms_pin.scenarios.values import unusable

__all__ = ["DEGREES", "Keys", "about", "angle", "key", "radians", "table"]

DEGREES = "_deg"  # ending of the keys that give an angle in degrees


def key(unit: str, default: str, what: str, *, required: bool = False, degrees: bool = False) -> Any:
    """A key of a table: its unit, what holds without it in words, and what it is.

    It has to be there if `required`; with `degrees` it may be given under its name with `_deg` as well.
    """
    more: dict[str, Any] = {"unit": unit, "default_in_words": default, "degrees": degrees}
    return Field(... if required else None, description=what, json_schema_extra=more)


def angle(unit: str, default: str, what: str, *, required: bool = False) -> Any:
    """A key that may be given in degrees as well."""
    return key(unit, default, what, required=required, degrees=True)


def table() -> Any:
    """A table inside a table."""
    return Field(None)


def about(field: FieldInfo) -> Mapping[str, Any]:
    """Unit, default in words, and whether degrees are taken; empty for a table inside a table."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


class Keys(BaseModel):
    """A table; what is no field of it is refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    _in_degrees: frozenset[str] = PrivateAttr(frozenset())

    @model_validator(mode="wrap")
    @classmethod
    def _take_degrees(cls, given: Any, handler: ModelWrapValidatorHandler[Keys]) -> Keys:
        """Read `joints_deg` as `joints`, and remember it: the number stays the file's."""
        if not isinstance(given, Mapping):
            return handler(given)
        angles = [name for name, field in cls.model_fields.items() if about(field).get("degrees")]
        turned = frozenset(name for name in angles if name + DEGREES in given)
        for name in turned:
            if name in given:
                raise unusable(f"has both {name} and {name}{DEGREES}; keep one")
        renamed = {name + DEGREES: name for name in turned}
        found = handler({renamed.get(name, name): value for name, value in given.items()})
        found._in_degrees = turned
        return found

    def said(self) -> dict[str, Any]:
        """What the file says, by key; angles in degrees under their names with `_deg`."""
        values: dict[str, Any] = {}
        for name, field in type(self).model_fields.items():
            if name in self.model_fields_set:
                said = field.alias or name + DEGREES * (name in self._in_degrees)
                values[said] = frozen(getattr(self, name))
        return values | {name: frozen(value) for name, value in (self.model_extra or {}).items()}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """With the keys in degrees."""
        found = handler(core_schema)
        schema = handler.resolve_ref_schema(found)
        for name, field in cls.model_fields.items():
            if about(field).get("degrees"):
                twin = {**schema["properties"][name], "unit": "deg", "degrees": False}
                schema["properties"][name + DEGREES] = twin
                if name in (required := schema.get("required", [])):
                    required.remove(name)
                    schema.setdefault("allOf", []).append(
                        {"anyOf": [{"required": [name]}, {"required": [name + DEGREES]}]}
                    )
        return found


def frozen(value: Any) -> Any:
    """Any value, its lists as tuples, its tables as dicts."""
    if isinstance(value, Keys):
        return value.said()
    if isinstance(value, list | tuple):
        return tuple(frozen(one) for one in value)
    return {name: frozen(one) for name, one in value.items()} if isinstance(value, dict) else value


def radians(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same values with those in degrees in radians, under their names without `_deg`."""
    return {
        name.removesuffix(DEGREES): _radians(value) if name.endswith(DEGREES) else value
        for name, value in values.items()
    }


def _radians(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: math.radians(one) for name, one in value.items()}
    return tuple(map(math.radians, value)) if isinstance(value, tuple) else math.radians(value)
