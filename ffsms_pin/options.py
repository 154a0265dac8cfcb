"""Types of options: the fields of frozen dataclasses, with the values that they take and their unit.

A field is written as ``delay: Annotated[NotNegative, Unit("s")] = 0.0`` with a docstring below it. Tables of
scenario files, their JSON Schema and the tables of the documentation are made from these fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias


@dataclass(frozen=True)
class Kind:
    """The values that a field takes in a file, by the name of their type in `ffsms_pin.scenarios.keys`."""

    name: str


@dataclass(frozen=True)
class Unit:
    """The unit of a field.

    Attributes
    ----------
    name : str
        Empty for a number without a unit.
    default : str
        The default in words, where the value does not tell it.
    """

    name: str = ""
    default: str = ""


@dataclass(frozen=True)
class Angle(Unit):
    """The unit of a field that a file may also give in degrees, under its name with _deg."""


Number: TypeAlias = Annotated[float, Kind("Number")]
Positive: TypeAlias = Annotated[float, Kind("Positive")]
NotNegative: TypeAlias = Annotated[float, Kind("NotNegative")]
# From zero to below one.
Share: TypeAlias = Annotated[float, Kind("Share")]
# Above zero or at least zero; inf for no limit.
Bound: TypeAlias = Annotated[float, Kind("Limit")]
Margin: TypeAlias = Annotated[float, Kind("Margin")]
AnyTime: TypeAlias = Annotated[float, Kind("AnyTime")]
Whole: TypeAlias = Annotated[int, Kind("Whole")]
Tries: TypeAlias = Annotated[int, Kind("Tries")]
Substeps: TypeAlias = Annotated[int, Kind("Substeps")]
AtLeastOne: TypeAlias = Annotated[int, Kind("AtLeastOne")]
Text: TypeAlias = Annotated[str, Kind("Text")]
# A text that is one of a list of names.
Integrator: TypeAlias = Annotated[str, Kind("Integrator")]
Collision: TypeAlias = Annotated[str, Kind("Collision")]
Texts: TypeAlias = Annotated[Any, Kind("Texts")]
Numbers: TypeAlias = Annotated[Any, Kind("Numbers")]
# Vectors of that many numbers, of numbers above zero, and rows of three numbers.
Vector3: TypeAlias = Annotated[Any, Kind("Vector3")]
Vector6: TypeAlias = Annotated[Any, Kind("Vector6")]
Sizes2: TypeAlias = Annotated[Any, Kind("Sizes2")]
Sizes3: TypeAlias = Annotated[Any, Kind("Sizes3")]
Rows: TypeAlias = Annotated[Any, Kind("Rows")]
# Pairs of a begin and a later end.
Spans: TypeAlias = Annotated[Any, Kind("Spans")]
# One number, or one for each joint, wheel or thruster.
PerJointPositive: TypeAlias = Annotated[Any, Kind("PerJointPositive")]
PerJointNotNegative: TypeAlias = Annotated[Any, Kind("PerJointNotNegative")]
PerJointLimit: TypeAlias = Annotated[Any, Kind("PerJointLimit")]
# Principal moments, or a matrix.
Inertia: TypeAlias = Annotated[Any, Kind("Inertia")]
# One vector, or one for each joint.
Shifts: TypeAlias = Annotated[Any, Kind("Shifts")]
NameOrIndex: TypeAlias = Annotated[str | int, Kind("NameOrIndex")]
