"""What a value in a scenario file may be: numbers in sane ranges, lists of them, and texts.

Values are as TOML writes them, without conversion: `true` is no number, and "3" is none either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, GetCoreSchemaHandler, Tag
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ffsms_pin.checks import LARGEST, SMALLEST_POSITIVE

__all__ = [
    "AnyTime",
    "ByJoint",
    "Gain",
    "Inertia",
    "Limit",
    "Margin",
    "NameOrIndex",
    "NotNegative",
    "Number",
    "Numbers",
    "OneOf",
    "PerJoint",
    "PerJointLimit",
    "PerJointNotNegative",
    "PerJointPositive",
    "Positive",
    "Rows",
    "Share",
    "Shifts",
    "Sizes2",
    "Sizes3",
    "Spans",
    "Text",
    "Texts",
    "Vector3",
    "Vector6",
    "Whole",
    "unusable",
]


def unusable(words: str) -> PydanticCustomError:
    """What a validator raises: `words` say what a value must be, as "must be above zero"."""
    return PydanticCustomError("unusable", "{words}", {"words": words})


@dataclass(frozen=True)
class OneOf:
    """One of a few texts that the library lists: `Literal` for a tuple that is known when it runs."""

    choices: tuple[str, ...]

    def __get_pydantic_core_schema__(self, kind: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the literals."""
        return core_schema.literal_schema(list(self.choices))


def _finite_or_infinite(value: float) -> float:
    if math.isnan(value) or LARGEST < value < math.inf:
        raise unusable(f"must be finite and at most {LARGEST:g}, or inf")
    return value


def _part(value: float) -> float:
    if not 0.0 <= value < 1.0:
        raise unusable("must be at least zero and below one")
    return value


def _forwards(span: tuple[float, ...]) -> tuple[float, ...]:
    if span[1] <= span[0]:
        raise unusable("must be pairs of a begin and a later end")
    return span


def _some_text(value: str) -> str:
    if not value.strip() or "\0" in value:
        raise unusable("must be a text that is not empty")
    return value


def _listed(size: int | None = None, of: str = "numbers") -> BeforeValidator:
    """A list of `size` entries, or of one or more of them."""

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


def _is_list(value: Any) -> str:
    return "list" if isinstance(value, list | tuple) else "one"


def _is_text(value: Any) -> str:
    return "name" if isinstance(value, str) else "index"


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
Share: TypeAlias = Annotated[float, AfterValidator(_part)]
Whole: TypeAlias = Annotated[int, Field(ge=0)]
Text: TypeAlias = Annotated[str, AfterValidator(_some_text)]

_TUPLE, _SOME = AfterValidator(tuple), _listed()
_TWO = Field(min_length=2, max_length=2)
_THREE = Field(min_length=3, max_length=3)
_SIX = Field(min_length=6, max_length=6)
Texts: TypeAlias = Annotated[list[Text], _TUPLE]
Numbers: TypeAlias = Annotated[list[Number], _TUPLE, _SOME]
ByJoint: TypeAlias = Annotated[dict[str, Number], BeforeValidator(_by_name)]
Vector3: TypeAlias = Annotated[list[Number], _THREE, _TUPLE, _listed(3)]
Sizes2: TypeAlias = Annotated[list[Positive], _TWO, _TUPLE, _listed(2)]
Sizes3: TypeAlias = Annotated[list[Positive], _THREE, _TUPLE, _listed(3)]
Vector6: TypeAlias = Annotated[list[Number], _SIX, _TUPLE, _listed(6)]
Rows: TypeAlias = Annotated[list[Vector3], _TUPLE, _listed(of="rows of 3 numbers")]
_Span: TypeAlias = Annotated[list[Number], _TWO, _TUPLE, AfterValidator(_forwards), _listed(2)]
Spans: TypeAlias = Annotated[list[_Span], _TUPLE, _listed(of="pairs of times")]
_Square: TypeAlias = Annotated[list[Numbers], _TUPLE, AfterValidator(_square)]

_ONE, _LIST, _FLAT, _ROWS = Tag("one"), Tag("list"), Tag("flat"), Tag("rows")
_NAME, _INDEX = Tag("name"), Tag("index")
_PER_JOINT, _BY_ROWS = Discriminator(_is_list), Discriminator(_has_rows)
# One number for all joints, or a list with one each; how many those are, only the robot knows.
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
NameOrIndex: TypeAlias = Annotated[Annotated[Text, _NAME] | Annotated[Whole, _INDEX], Discriminator(_is_text)]
