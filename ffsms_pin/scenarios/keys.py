"""Tables of a scenario file as models: what values may be, and keys with units, defaults, and degrees.

Values are as TOML writes them, without conversion: `true` is no number, and "3" is none either. Every key is
a field made by `key` or `angle`; the page of the documentation, the JSON Schema and the checks follow from
it. A key that a file leaves out is left out of the model, too: the library's defaults apply. All names
without an underscore are for the tables.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import sys
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Annotated, Any, TypeAlias, get_args, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PrivateAttr,
    Tag,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ffsms_pin.checks import LARGEST, SMALLEST_POSITIVE
from ffsms_pin.geometry.bodies import MODES as COLLISION_MODES
from ffsms_pin.options import Angle, Kind, Unit
from ffsms_pin.simulation import INTEGRATORS

DEGREES = "_deg"  # ending of the keys that give an angle in degrees


def unusable(words: str) -> PydanticCustomError:
    """Return the error of a validator; `words` are what a value must be, as "must be above zero"."""
    return PydanticCustomError("unusable", "{words}", {"words": words})


@dataclass(frozen=True)
class OneOf:
    """A choice of texts that the library lists: `Literal` for a tuple that is known at run time."""

    choices: tuple[str, ...]

    def __get_pydantic_core_schema__(self, kind: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the literals."""
        return core_schema.literal_schema(list(self.choices))


def _finite_or_infinite(value: float) -> float:
    if math.isnan(value) or LARGEST < value < math.inf:
        raise unusable(f"must be finite and at most {LARGEST:g}, or inf")
    return value


def _only(holds: Callable[[Any], bool], words: str) -> AfterValidator:
    """Return a check of a value; `words` are what it must be."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise unusable(words)
        return value

    return AfterValidator(check)


def _listed(size: int | None = None, of: str = "numbers") -> BeforeValidator:
    """Return a check for a list of `size` entries, or of one or more."""

    def check(value: Any) -> Any:
        if not isinstance(value, list | tuple) or not value or size not in (None, len(value)):
            raise unusable(f"must be a list of {size or 'one or more'} {of}")
        return list(value)

    return BeforeValidator(check)


def _by_name(value: Any) -> Any:
    if not isinstance(value, dict) or not value:
        raise unusable("must be a table of numbers by joint, as {joint_2 = 0.5}")
    return value


def _square(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if any(len(row) != len(rows) for row in rows):
        raise unusable(f"must be a list of {len(rows)} rows of {len(rows)} numbers each")
    return rows


def _has_rows(value: Any) -> str:
    several = isinstance(value, list | tuple) and value
    return "rows" if several and all(isinstance(row, list | tuple) for row in value) else "flat"


Number: TypeAlias = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive: TypeAlias = Annotated[float, Field(ge=SMALLEST_POSITIVE, le=LARGEST, allow_inf_nan=False)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False)]
# Above zero, and at least zero, where inf stands for none.
Limit: TypeAlias = Annotated[float, Field(ge=SMALLEST_POSITIVE), AfterValidator(_finite_or_infinite)]
Margin: TypeAlias = Annotated[float, Field(ge=0.0), AfterValidator(_finite_or_infinite)]
AnyTime: TypeAlias = Annotated[float, Field(ge=-LARGEST), AfterValidator(_finite_or_infinite)]
Share: TypeAlias = Annotated[
    float, _only(lambda value: 0.0 <= value < 1.0, "must be at least zero and below one")
]
Whole: TypeAlias = Annotated[int, Field(ge=0)]
AtLeastOne: TypeAlias = Annotated[int, Field(ge=1)]
Substeps: TypeAlias = Annotated[int, Field(ge=1, le=1000)]
Tries: TypeAlias = Annotated[int, Field(ge=1, le=100)]
Text: TypeAlias = Annotated[
    str, _only(lambda text: text.strip() and "\0" not in text, "must be a text that is not empty")
]

_TUPLE, _SOME = AfterValidator(tuple), _listed()
_TWO = Field(min_length=2, max_length=2)
_THREE = Field(min_length=3, max_length=3)
_SIX = Field(min_length=6, max_length=6)
Integrator: TypeAlias = Annotated[str, OneOf(tuple(INTEGRATORS))]
Collision: TypeAlias = Annotated[str, OneOf(COLLISION_MODES)]
Texts: TypeAlias = Annotated[list[Text], _TUPLE]
Numbers: TypeAlias = Annotated[list[Number], _TUPLE, _SOME]
ByJoint: TypeAlias = Annotated[dict[str, Number], BeforeValidator(_by_name)]
Vector3: TypeAlias = Annotated[list[Number], _THREE, _TUPLE, _listed(3)]
Sizes2: TypeAlias = Annotated[list[Positive], _TWO, _TUPLE, _listed(2)]
Sizes3: TypeAlias = Annotated[list[Positive], _THREE, _TUPLE, _listed(3)]
Vector6: TypeAlias = Annotated[list[Number], _SIX, _TUPLE, _listed(6)]
Rows: TypeAlias = Annotated[list[Vector3], _TUPLE, _listed(of="rows of 3 numbers")]
_FORWARDS = _only(lambda span: span[1] > span[0], "must be pairs of a begin and a later end")
_Span: TypeAlias = Annotated[list[Number], _TWO, _TUPLE, _FORWARDS, _listed(2)]
Spans: TypeAlias = Annotated[list[_Span], _TUPLE, _listed(of="pairs of times")]
_Square: TypeAlias = Annotated[list[Numbers], _TUPLE, AfterValidator(_square)]

_ONE, _LIST, _FLAT, _ROWS = Tag("one"), Tag("list"), Tag("flat"), Tag("rows")
_NAME, _INDEX = Tag("name"), Tag("index")
_PER_JOINT = Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "one")
_BY_ROWS = Discriminator(_has_rows)
_NAMED = Discriminator(lambda value: "name" if isinstance(value, str) else "index")
# One number for all joints, or a list with one each, whose length is checked against the robot.
PerJoint: TypeAlias = Annotated[Annotated[Number, _ONE] | Annotated[Numbers, _LIST], _PER_JOINT]
PerJointPositive: TypeAlias = Annotated[
    Annotated[Positive, _ONE] | Annotated[list[Positive], _TUPLE, _SOME, _LIST], _PER_JOINT
]
PerJointNotNegative: TypeAlias = Annotated[
    Annotated[NotNegative, _ONE] | Annotated[list[NotNegative], _TUPLE, _SOME, _LIST], _PER_JOINT
]
PerJointLimit: TypeAlias = Annotated[
    Annotated[Limit, _ONE] | Annotated[list[Limit], _TUPLE, _SOME, _LIST], _PER_JOINT
]
# One number, one a joint, or a square matrix.
Gain: TypeAlias = Annotated[Annotated[PerJoint, _FLAT] | Annotated[_Square, _ROWS], _BY_ROWS]
# Principal moments, or a matrix.
Inertia: TypeAlias = Annotated[
    Annotated[Sizes3, _FLAT] | Annotated[list[Vector3], _THREE, _TUPLE, _listed(3), _ROWS], _BY_ROWS
]
# One vector, or one a joint.
Shifts: TypeAlias = Annotated[Annotated[Vector3, _FLAT] | Annotated[Rows, _ROWS], _BY_ROWS]
NameOrIndex: TypeAlias = Annotated[Annotated[Text, _NAME] | Annotated[Whole, _INDEX], _NAMED]


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
        kind = next((globals()[part.name] for part in parts if isinstance(part, Kind)), None)
        required = field.default is MISSING and field.default_factory is MISSING
        made[field.name] = (
            get_args(hint)[0] if kind is None else kind,
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
