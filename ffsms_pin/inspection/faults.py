"""Faults of a URDF and their repair, and the search for numbers that are not plain decimals."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

from ffsms_pin.system.urdf_elements import INERTIA_KEYS, UNLIMITED, is_number, label


@dataclass(frozen=True)
class Change:
    """A change that a repair made to a link, a joint or the file.

    Attributes
    ----------
    where : str
        The link, joint or file.
    problem : str
        The problem.
    remedy : str
        The change.
    """

    where: str
    problem: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}; {self.remedy}"


@dataclass(frozen=True)
class Fault:
    """A fault or a doubtful entry in a file.

    Attributes
    ----------
    where : str
        The link, joint or file.
    problem : str
        The problem.
    blocks : bool
        True if `load` refuses the file because of the fault.
    remedy : str or None
        The change that a repair makes; None if the repair does not change it.
    mend : callable or None
        The function that makes this change.
    """

    where: str
    problem: str
    blocks: bool
    remedy: str | None = None
    mend: Callable[[], object] | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


@dataclass(frozen=True)
class Settings:
    """The path of the file, and the rate [rad/s, m/s] and effort [N m, N] for joints without these limits."""

    path: Path
    rate: float
    effort: float


# The numeric attributes of elements, and the number of values of each attribute.
_ATTRIBUTES: dict[str, dict[str, int]] = {
    "mass": {"value": 1},
    "inertia": dict.fromkeys(INERTIA_KEYS, 1),
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "velocity": 1, "effort": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
}
# Elements whose unreadable numbers are not reported as blocking.
_NOT_READ = {"cylinder", "capsule", "sphere", "mesh"}
_COMMA = re.compile(r"[+-]?\d+,\d+", re.ASCII)
_FORMULA = re.compile(r"(?:[\d.+\-*/() \t]|[eE](?=[+-]?\d)|math\.pi|M_PI|PI|pi)+", re.ASCII)
_OPERATORS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
# Longer texts are not parsed as formulas, because Python's parser may raise other exceptions for them.
_LONGEST = 100


def elements(robot: ElementTree.Element) -> Iterator[tuple[str, ElementTree.Element]]:
    """Yield all links, then all joints, each with its label for messages."""
    for kind in ("link", "joint"):
        for item in robot.findall(kind):
            yield label(item), item


def number_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find numeric attributes that are not the expected count of plain decimals."""
    for where, item in elements(robot):
        yield from faults_in(item, where)


def faults_in(item: ElementTree.Element, where: str) -> Iterator[Fault]:
    """Find such attributes (see `number_faults`) in one link, joint or shape."""
    for element in item.iter():
        for key, count in _ATTRIBUTES.get(str(element.tag), {}).items():
            text = element.get(key)
            numbers = [text] if count == 1 or text is None else text.split()
            if text is None or (len(numbers) == count and all(is_number(str(number)) for number in numbers)):
                continue
            better = _mended(text, count, f"{element.tag} {key}")
            expected = "a plain decimal number" if count == 1 else f"{count} plain decimal numbers"
            problem = f'{key}="{text}" in <{element.tag}> is not {expected}; readers drop or refuse it'
            remedy = None if better is None else f'written as "{better}"'
            mend = None if better is None else partial(element.set, key, better)
            yield Fault(where, problem, element.tag not in _NOT_READ, remedy, mend)


def mended_number(text: str) -> str | None:
    """Return the plain decimal number that `text` represents, or None if it represents no finite number.

    Surrounding blanks, a decimal comma, and formulas of numbers and pi ("pi/2", "${-pi/4}") are accepted.
    """
    text = text.strip()
    if text.startswith("${") and text.endswith("}"):
        text = text[2:-1].strip()
    if _COMMA.fullmatch(text):
        text = text.replace(",", ".")
    if is_number(text):
        return text
    if len(text) > _LONGEST or not _FORMULA.fullmatch(text):
        return None
    try:
        value = _value(ast.parse(text, mode="eval").body)
    except (SyntaxError, ValueError, ZeroDivisionError, OverflowError, RecursionError, MemoryError):
        return None
    return repr(value) if math.isfinite(value) else None


def _value(node: ast.AST) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return float(node.value)
    if isinstance(node, (ast.Name, ast.Attribute)):
        if ast.unparse(node) not in ("math.pi", "M_PI", "PI", "pi"):
            raise ValueError
        return math.pi
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.operand))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.left), _value(node.right))
    raise ValueError


def _mended(text: str, count: int, attribute: str) -> str | None:
    if count == 1:
        if attribute.startswith("limit") and text.strip().lower().lstrip("+-") in ("inf", "infinity"):
            return "-" + UNLIMITED if text.strip().startswith("-") else UNLIMITED
        return mended_number(text)
    for parts in (text.split(), text.replace(",", " ").split()):
        mended = [mended_number(word) for word in parts]
        if len(parts) == count and None not in mended:
            return " ".join(str(word) for word in mended)
    return None
