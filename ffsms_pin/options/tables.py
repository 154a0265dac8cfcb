"""Tables of options in files: pydantic models, made from fields and parameters with a unit.

A key of a table is a field of a dataclass, or a parameter of a class or function, such as
``delay: Annotated[NotNegative, Unit("s")] = 0.0``. The type of a nested table is
``Annotated[Any, table_of(...)]``.
The checks, the JSON Schema and the page of the documentation are made from the models. A key that a file
leaves out is absent from the values of the file, so that the library's default applies.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import re
import sys
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
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

DEGREES = "_deg"  # ending of keys for angles in degrees
OWN = "package.module:Class"  # the choice for a user's own class


class Keys(BaseModel):
    """A table, which by default rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    # The key that chooses a table, and the tables by the key's value; `tables_by` sets both.
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
        """Return the keys of this table that some tables of `choices` lack."""
        others = [table.model_fields for table in cls.choices.values() if table.chooser]
        return [name for name in cls.model_fields if any(name not in fields for fields in others)]

    def given_values(self) -> dict[str, Any]:
        """Return the values by the keys in the file; angles in degrees have keys with `_deg`."""
        values: dict[str, Any] = {}
        for name in type(self).model_fields:
            if name in self.model_fields_set:
                values[name + DEGREES * (name in self._in_degrees)] = frozen(getattr(self, name))
        return values | {name: frozen(value) for name, value in (self.model_extra or {}).items()}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the JSON Schema, in which each angle has a second key for degrees."""
        reference = handler(core_schema)
        schema = handler.resolve_ref_schema(reference)
        for name in cls.angle_keys():
            twin = {**schema["properties"][name], "unit": "deg", "degrees": False}
            schema["properties"][name + DEGREES] = twin
            if name in (required := schema.get("required", [])):
                required.remove(name)
                schema.setdefault("allOf", []).append(
                    {"anyOf": [{"required": [name]}, {"required": [name + DEGREES]}]}
                )
        return reference


def about(field: FieldInfo) -> Mapping[str, Any]:
    """Return a field's unit, its default as text, and `degrees`, which is True for an angle.

    The result is empty for a nested table.
    """
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def models_in(annotation: Any) -> list[type[Keys]]:
    """Return the models of tables in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, Keys):
        return [annotation]
    return [model for inner in get_args(annotation) for model in models_in(inner)]


class OwnKeys(Keys):
    """The table of a user's own class, whose further keys are the arguments of the class."""

    model_config = ConfigDict(extra="allow")


class FileKeys:
    """The base class of tables whose keys only a file has; subclasses become dataclasses."""

    def __init_subclass__(cls) -> None:
        dataclasses.dataclass(kw_only=True, eq=False)(cls)


class Option(NamedTuple):
    """A field or parameter that is a key of a table; `unit` is None for a nested table."""

    kind: Any
    unit: Unit | None
    default: str
    what: str
    required: bool

    @property
    def key(self) -> tuple[Any, Any]:
        """The type and the pydantic field of the option."""
        if self.unit is None:
            return self.kind, Field(None)
        more: dict[str, Any] = {"unit": self.unit.name, "default_in_words": self.default}
        more["degrees"] = isinstance(self.unit, Angle)
        value = ... if self.required else None
        return self.kind, Field(value, description=self.what, json_schema_extra=more)


@cache
def options_of(source: Any) -> dict[str, Option]:
    """Return the options of a class or function: nested tables, and fields or parameters with a unit."""
    what, options = descriptions(source), {}
    for name, parameter in inspect.signature(source).parameters.items():
        if not str(parameter.annotation).startswith("Annotated["):
            continue
        hint = _hint(source, parameter)
        parts = _metadata(hint)
        unit = next((part for part in parts if isinstance(part, Unit)), None)
        kinds = [Annotated[Any, part] for part in parts if isinstance(part, Kind)]
        tables = [part for part in parts if models_in(part)]
        if unit is None and not tables:
            continue
        kind = [*tables, *kinds, get_args(hint)[0]][0]
        required = parameter.default is parameter.empty
        default = "" if required else (unit and unit.default) or in_words(parameter.default)
        options[name] = Option(kind, unit, default, what.get(name, ""), required)
    return options


def table_of(*sources: Any, omit: Collection[str] = (), defaults: Mapping[str, str] | None = None) -> Any:
    """Return a table whose keys are the options of classes or functions.

    Parameters
    ----------
    *sources : class or function
        The first source sets the table's name and description. If several sources have an option, the first
        of these sources sets it.
    omit : collection of str
        Options of the other sources that are no keys of the table.
    defaults : mapping, optional
        Texts of defaults by key, if the default in a file differs from the library's. These keys are
        optional.
    """
    return _table(sources[0].__name__, sources[0], _options(sources, omit, defaults))


def tables_by(
    chooser: str,
    base: type[FileKeys],
    choices: Mapping[str, Any],
    *shared: Any,
    bases: Mapping[str, type[FileKeys]] | None = None,
    omit: Collection[str] = (),
    defaults: Mapping[str, str] | None = None,
    own: Any = None,
) -> Any:
    """Return the union of tables, one for each value of a key, such as the laws of [control].

    The value of the key in a file chooses the table.

    Parameters
    ----------
    chooser : str
        The key whose value chooses the table, such as "law".
    base : type
        A class with the keys of all tables, `chooser` first.
    choices : mapping
        Classes or functions whose options are further keys, or None, by value of the key.
    *shared : class or function
        Sources of further keys of all tables.
    bases : mapping, optional
        Classes that replace `base`, by value of the key.
    omit, defaults
        As in `table_of`.
    own : type, optional
        The table for a user's own class, if the value of the key is an import path.
    """
    tables: dict[str, type[Keys]] = {}
    for choice, source in choices.items():
        chosen_base = (bases or {}).get(choice, base)
        sources = [chosen_base, *([] if source is None else [source]), *shared]
        options = _options(sources, omit, defaults)
        required = options[chooser].default != f'"{choice}"'
        options[chooser] = options[chooser]._replace(kind=Literal[choice], required=required)
        tables[choice] = _table(f"{chosen_base.__name__}.{choice}", source or base, options)
    for table in tables.values():
        table.chooser, table.choices = chooser, tables
    if own is not None:
        tables[OWN] = _table(own.__name__, own, options_of(own), OwnKeys)
    default = [name for name, table in tables.items() if not table.model_fields[chooser].is_required()]

    def chosen(row: Any) -> str | None:
        """Return the tag of a file's table; None if the chooser is missing and has no default."""
        value = row.get(chooser) if isinstance(row, Mapping) else next(iter(tables))
        if value is None:
            return next(iter(default), None)
        return OWN if OWN in tables and ":" in str(value) else str(value)

    tagged = tuple(Annotated[table, Tag(choice)] for choice, table in tables.items())
    return Annotated[Union[tagged], Discriminator(chosen)]  # noqa: UP007


def by_name(classes: Iterable[Any]) -> dict[str, Any]:
    """Return classes by their attribute `name`, in which hyphens replace spaces."""
    return {kind.name.replace(" ", "-"): kind for kind in classes}


def file_of(tables: Mapping[str, Any], name: str, what: str, required: Collection[str]) -> type[Keys]:
    """Return the model of a file with these tables; `what` is its docstring.

    An absent table that is `required` is read as an empty table, so its missing keys are reported.
    """
    fields: dict[str, Any] = {
        title: (kind, Field({}, validate_default=True) if title in required else Field(None))
        for title, kind in tables.items()
    }
    return create_model(name, __base__=Keys, __doc__=what, **fields)


def _options(
    sources: Sequence[Any], omit: Collection[str], defaults: Mapping[str, str] | None
) -> dict[str, Option]:
    """Return the options of several sources; see `table_of` for the parameters."""
    options: dict[str, Option] = {}
    for source in sources:
        for name, option in options_of(source).items():
            if defaults and name in defaults:
                option = option._replace(default=defaults[name], required=False)
            if source is sources[0] or name not in omit:
                options.setdefault(name, option)
    return options


def _table(name: str, source: Any, options: Mapping[str, Option], base: type[Keys] = Keys) -> Any:
    """Return the table of options, described by the first line of the source's docstring."""
    title = (inspect.getdoc(source) or "").partition("\n")[0]
    fields: dict[str, Any] = {key: option.key for key, option in options.items()}
    return create_model(name, __base__=base, __doc__=title, **fields)


def _hint(source: Any, parameter: inspect.Parameter) -> Any:
    """Return the type of a parameter with its metadata.

    Annotations of other parameters are not evaluated, because their types may be imported for type checking
    only.
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
    return {name: " ".join(text.split()).rstrip(".") for name, text in texts.items()}


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


def table_at(tables: Mapping[str, Any], path: str) -> tuple[str, Mapping[str, Any]]:
    """Return the title of a table in messages, and the values of the table.

    `path` is the table's name in dots, such as "client.sensor"; "via.2" is the second of the tables [[via]].
    """
    values: Any = tables
    title, row = path, ""
    for step in path.split("."):
        if step.isdecimal():
            values, title, row = values[int(step) - 1], path.rpartition(".")[0], f" {step}"
        else:
            values = values.get(step) or {}
    return (f"[[{title}]]{row}" if row else f"[{title}]"), values


def in_line(value: Any) -> str:
    """Return a value of a file as text in one line; tables are in parentheses."""
    if isinstance(value, Mapping):
        return "(" + ", ".join(f"{key} {in_line(inner)}" for key, inner in value.items()) + ")"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(in_line, value)) + "]"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def frozen(value: Any) -> Any:
    """Return a value with lists as tuples and tables as dicts."""
    if isinstance(value, Keys):
        return value.given_values()
    if isinstance(value, list | tuple):
        return tuple(frozen(item) for item in value)
    return {name: frozen(item) for name, item in value.items()} if isinstance(value, dict) else value


def radians(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table's values, with angles in radians under keys without `_deg`."""
    return {
        name.removesuffix(DEGREES): _radians(value) if name.endswith(DEGREES) else value
        for name, value in values.items()
    }


def _radians(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: math.radians(angle) for name, angle in value.items()}
    return tuple(map(math.radians, value)) if isinstance(value, tuple) else math.radians(value)
