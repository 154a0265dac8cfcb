"""The types of options: fields of classes, and parameters of functions, with a unit and allowed values.

A field is written as ``delay: Annotated[NotNegative, Unit("s")] = 0.0`` with a docstring below it. The tables
of scenario files, their JSON Schema and the tables of the documentation are made from these fields. Values in
a file are not converted: `true` and "3" are not numbers.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from ffsms_pin.checks import LARGEST, SMALLEST_POSITIVE


@dataclass(frozen=True)
class Unit:
    """The unit of a field.

    Attributes
    ----------
    name : str
        The unit, empty for a number without one.
    default : str
        The default as text, if the field's value does not show it (for example None).
    """

    name: str = ""
    default: str = ""


@dataclass(frozen=True)
class Angle(Unit):
    """The unit of an angle, which a file may also give in degrees, with _deg appended to the field's name."""


def unusable(requirement: str) -> Exception:
    """Return the error about a value in a file; `requirement` is a text such as "must be above zero"."""
    from pydantic_core import PydanticCustomError  # imported here, because only files need it

    return PydanticCustomError("unusable", "{requirement}", {"requirement": requirement})


class Kind(ABC):
    """The allowed values of a field in a file."""

    @abstractmethod
    def schema(self) -> Any:
        """Return the kind as a pydantic schema; pydantic is imported only for files."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the schema of the kind, which replaces the schema of the annotated type."""
        return self.schema()


@dataclass(frozen=True)
class Real(Kind):
    """A number from `least` to `checks.LARGEST`; with `infinite` it may also be inf, which means no limit."""

    least: float = -LARGEST
    infinite: bool = False

    def schema(self) -> Any:
        """Return the schema of a float."""
        from pydantic_core.core_schema import float_schema

        positive = self.least == SMALLEST_POSITIVE
        bounds = f"above zero, at most {LARGEST:g}" if positive else f"from {self.least:g} to {LARGEST:g}"
        requirement = f"must be a finite number {bounds}"
        if not self.infinite:
            number = float_schema(strict=True, ge=self.least, le=LARGEST, allow_inf_nan=False)
            return _described(number, requirement)
        requirement += ", or inf"
        number = _described(float_schema(strict=True, ge=self.least), requirement)
        return _checked(number, lambda value: value <= LARGEST or value == math.inf, requirement)


@dataclass(frozen=True)
class Integer(Kind):
    """A whole number from `least` to `most`; None is no upper bound."""

    least: int
    most: int | None = None

    def schema(self) -> Any:
        """Return the schema of an int."""
        from pydantic_core.core_schema import int_schema

        bounds = f"of at least {self.least}" if self.most is None else f"from {self.least} to {self.most}"
        requirement = f"must be a whole number {bounds}"
        return _described(int_schema(strict=True, ge=self.least, le=self.most), requirement)


@dataclass(frozen=True)
class Name(Kind):
    """A text that is not blank, has no NUL character, and in which the regex `pattern`, if any, is found."""

    pattern: str | None = None

    def schema(self) -> Any:
        """Return the schema of a str."""
        from pydantic_core.core_schema import str_schema

        requirement = "must be a text that is not empty"
        text = _described(str_schema(strict=True, pattern=self.pattern), requirement)
        return _checked(text, lambda value: value.strip() and "\0" not in value, requirement)


@dataclass(frozen=True)
class OneOf(Kind):
    """A text from `choices`, for choices that are known only at run time."""

    choices: tuple[str, ...]

    def schema(self) -> Any:
        """Return the schema that accepts only the `choices`."""
        from pydantic_core.core_schema import literal_schema

        return literal_schema(list(self.choices))


@dataclass(frozen=True)
class List(Kind):
    """A list of `size` values of the kind `of`; if `size` is None, of one or more values.

    With `empty` the list may be empty. `what` names the values in messages.
    """

    of: Kind
    size: int | None = None
    what: str = "numbers"
    empty: bool = False

    def schema(self) -> Any:
        """Return the schema of a list or tuple."""
        from pydantic_core.core_schema import list_schema, no_info_before_validator_function

        count = "" if self.empty else f"{self.size or 'one or more'} "

        def check(value: Any) -> Any:
            sized = isinstance(value, list | tuple) and self.size in (None, len(value))
            if not sized or not (value or self.empty):
                raise unusable(f"must be a list of {count}{self.what}")
            return value

        least = 0 if self.empty else self.size or 1
        values = list_schema(self.of.schema(), min_length=least, max_length=self.size)
        return no_info_before_validator_function(check, values)


@dataclass(frozen=True)
class ByName(Kind):
    """A table with one or more values of the kind `of` by name; `what` describes the values in messages."""

    of: Kind
    what: str

    def schema(self) -> Any:
        """Return the schema of a dict."""
        from pydantic_core.core_schema import dict_schema, no_info_before_validator_function, str_schema

        def check(value: Any) -> Any:
            if not isinstance(value, dict) or not value:
                raise unusable(f"must be a table of {self.what}")
            return value

        return no_info_before_validator_function(check, dict_schema(str_schema(), self.of.schema()))


@dataclass(frozen=True)
class Table(Kind):
    """A table of any content."""

    def schema(self) -> Any:
        """Return the schema of a dict."""
        from pydantic_core.core_schema import dict_schema, str_schema

        return dict_schema(str_schema())


@dataclass(frozen=True)
class Either(Kind):
    """A value of kind `then` if `holds(value)` is true, else of kind `otherwise`."""

    holds: Callable[[Any], bool]
    then: Kind
    otherwise: Kind

    def schema(self) -> Any:
        """Return the schema of the union."""
        from pydantic_core.core_schema import tagged_union_schema

        kinds = {"then": self.then.schema(), "otherwise": self.otherwise.schema()}
        return tagged_union_schema(kinds, lambda value: "then" if self.holds(value) else "otherwise")


@dataclass(frozen=True)
class Only(Kind):
    """A value of the kind `of` for which `holds(value)` is true; `requirement` is the text in messages."""

    of: Kind
    holds: Callable[[Any], bool]
    requirement: str

    def schema(self) -> Any:
        """Return the schema of the kind with the check."""
        return _checked(self.of.schema(), self.holds, self.requirement)


def _described(schema: Any, requirement: str) -> Any:
    """Return a schema whose errors have the text `requirement`."""
    from pydantic_core.core_schema import custom_error_schema

    return custom_error_schema(schema, "unusable", custom_error_message=requirement)


def _checked(schema: Any, holds: Callable[[Any], Any], requirement: str) -> Any:
    """Return a schema with a check of its value; `requirement` is the text in messages."""
    from pydantic_core.core_schema import no_info_after_validator_function

    def check(value: Any) -> Any:
        if not holds(value):
            raise unusable(requirement)
        return value

    return no_info_after_validator_function(check, schema)


def _is_list(value: Any) -> bool:
    return isinstance(value, list | tuple)


def _has_rows(value: Any) -> bool:
    return _is_list(value) and len(value) > 0 and all(map(_is_list, value))


def values_per_joint(kind: Kind) -> Either:
    """Return the kind of a value for all joints, or of a list with one value per joint.

    The length of the list is checked later, when the robot is known.
    """
    return Either(_is_list, List(kind), kind)


_POSITIVE, _THREE = Real(SMALLEST_POSITIVE), List(Real(), 3)
_SPAN = Only(List(Real(), 2), lambda span: span[1] > span[0], "must be a pair of a start and a later end")
_SQUARE = Only(
    List(List(Real()), what="rows"),
    lambda rows: all(len(row) == len(rows) for row in rows),
    "must be a square matrix: as many numbers per row as there are rows",
)

Number: TypeAlias = Annotated[float, Real()]
Positive: TypeAlias = Annotated[float, _POSITIVE]
NotNegative: TypeAlias = Annotated[float, Real(0.0)]
Share: TypeAlias = Annotated[
    float, Only(Real(), lambda share: 0.0 <= share < 1.0, "must be a share, at least zero and below one")
]
# Numbers above zero, at least zero, or any; each may also be inf, which means no limit.
Bound: TypeAlias = Annotated[float, Real(SMALLEST_POSITIVE, infinite=True)]
Margin: TypeAlias = Annotated[float, Real(0.0, infinite=True)]
AnyTime: TypeAlias = Annotated[float, Real(infinite=True)]
Whole: TypeAlias = Annotated[int, Integer(0)]
AtLeastOne: TypeAlias = Annotated[int, Integer(1)]
Tries: TypeAlias = Annotated[int, Integer(1, 100)]
Substeps: TypeAlias = Annotated[int, Integer(1, 1000)]
Text: TypeAlias = Annotated[str, Name()]
Texts: TypeAlias = Annotated[Any, List(Name(), what="texts", empty=True)]
Numbers: TypeAlias = Annotated[Any, List(Real())]
ByJoint: TypeAlias = Annotated[Any, ByName(Real(), "numbers by joint, such as {joint_2 = 0.5}")]
# Vectors of fixed size (`Sizes2`, `Sizes3`: of numbers above zero), rows of three numbers, and time spans.
Vector3: TypeAlias = Annotated[Any, _THREE]
Vector6: TypeAlias = Annotated[Any, List(Real(), 6)]
Sizes2: TypeAlias = Annotated[Any, List(_POSITIVE, 2)]
Sizes3: TypeAlias = Annotated[Any, List(_POSITIVE, 3)]
Rows: TypeAlias = Annotated[Any, List(_THREE, what="rows of 3 numbers")]
Spans: TypeAlias = Annotated[Any, List(_SPAN, what="pairs of times")]
# One number, or one number for each joint, wheel, thruster or axis.
PerJoint: TypeAlias = Annotated[Any, values_per_joint(Real())]
PerJointPositive: TypeAlias = Annotated[Any, values_per_joint(_POSITIVE)]
PerJointNotNegative: TypeAlias = Annotated[Any, values_per_joint(Real(0.0))]
PerJointLimit: TypeAlias = Annotated[Any, values_per_joint(Real(SMALLEST_POSITIVE, infinite=True))]
# One number, one number for each joint, or a square matrix.
Gain: TypeAlias = Annotated[Any, Either(_has_rows, _SQUARE, values_per_joint(Real()))]
# Three principal moments of inertia, or a matrix (3, 3).
_INERTIA = Either(_has_rows, List(_THREE, 3), List(_POSITIVE, 3))
Inertia: TypeAlias = Annotated[Any, _INERTIA]


@dataclass(frozen=True)
class RigidBody(Kind):
    """A table of `mass`, `inertia` about the centre of mass, and optionally `com`."""

    def schema(self) -> Any:
        """Return the schema of a dict with the keys `mass`, `inertia` and, optionally, `com`."""
        from pydantic_core import core_schema

        def check(value: Any) -> Any:
            if not {"mass", "inertia"} <= value.keys() <= {"mass", "inertia", "com"}:
                raise unusable("must have the keys mass and inertia, and may have com")
            return value

        kinds = {"mass": _POSITIVE, "inertia": _INERTIA, "com": _THREE}
        fields = {
            key: core_schema.typed_dict_field(kind.schema(), required=key != "com")
            for key, kind in kinds.items()
        }
        return core_schema.no_info_before_validator_function(check, core_schema.typed_dict_schema(fields))


# Masses or rigid bodies by the names of links.
Bodies: TypeAlias = Annotated[
    Mapping[str, Any],
    ByName(
        Either(lambda value: isinstance(value, dict), RigidBody(), _POSITIVE),
        "masses or bodies by link, such as {base = 30.0}",
    ),
]
# One vector (3,), or one vector for each joint.
Shifts: TypeAlias = Annotated[Any, Either(_has_rows, List(_THREE, what="rows of 3 numbers"), _THREE)]
NameOrIndex: TypeAlias = Annotated[
    str | int, Either(lambda value: isinstance(value, str), Name(), Integer(0))
]
