"""Test the checks of numbers, shapes and types of arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

from ffsms_pin import checks
from ffsms_pin.errors import FfsmsError, InvalidValue

Refused = Callable[..., FfsmsError]


@pytest.mark.parametrize("value", [1e9, -1e9, 0, 0.5, np.float32(2.0), np.int64(-3), np.array(4.0)])
def test_numbers_up_to_1e9_pass(value: Any) -> None:
    assert checks.number("x", value) == float(value)
    assert type(checks.number("x", value)) is float


@pytest.mark.parametrize(
    "value", [1.01e9, -1e10, 1e300, np.inf, np.nan, 10**400, True, np.True_, "1", None, 1j, [1.0]]
)
def test_other_values_are_refused(refused: Refused, value: Any) -> None:
    refused(lambda: checks.number("x", value), InvalidValue, "x must")
    refused(lambda: checks.per_joint("x", value, 2), InvalidValue, "x must")
    if not isinstance(value, (bool, np.bool_)):  # in an array numpy converts it to a number
        refused(lambda: checks.vector("x", [0.0, value], 2), InvalidValue, "x must")
        refused(lambda: checks.matrix("x", [[0.0, value]], 1, 2), InvalidValue, "x must")


def test_positive_numbers_have_a_smallest_and_a_largest_value(refused: Refused) -> None:
    for value in (1e-12, 1e12, 1):
        assert checks.positive("x", value) == float(value)
    for value in (0, -1.0):
        refused(lambda value=value: checks.positive("x", value, "s"), InvalidValue, "above zero [s]")
    for value in (9e-13, 5e-324, 1.1e12, 1e300):
        refused(lambda value=value: checks.positive("x", value, "s"), InvalidValue, "1e-12", "1e+12", "[s]")


def test_the_number_of_steps_is_limited(refused: Refused) -> None:
    assert checks.step_count("dt", 1.0, 0.3) == 3
    assert checks.step_count("dt", 1.0, 5.0) == 1
    refused(lambda: checks.step_count("dt", 1e9, 1e-3), InvalidValue, "dt", "1e+12 steps")
    assert checks.step_count("dt", 1e9, 1.0, most=10**9) == 10**9


def test_types_choices_and_whole_numbers(refused: Refused) -> None:
    checks.instance("x", None, dict, optional=True)
    refused(lambda: checks.instance("x", np.array(0.0), Iterable), InvalidValue, "x must be an iterable")
    refused(lambda: checks.instance("x", None, dict), InvalidValue, "x must be a dict, got None")
    refused(lambda: checks.instance("x", [], dict, optional=True), InvalidValue, "a dict or None")
    refused(lambda: checks.optional_callable("x", 1), InvalidValue, "a function or None")
    for value in ("c", np.array(["a", "b"]), None, ["a"]):
        refused(lambda value=value: checks.one_of("x", value, ("a", "b")), InvalidValue, '"a" or "b"')
    for count in (True, 1.0, -1, "1"):
        refused(lambda count=count: checks.whole("x", count, 0), InvalidValue, "at least 0")


@pytest.mark.parametrize(
    "matrix", [np.diag([1, 1, -1]), 2 * np.eye(3), np.zeros((3, 3)), 1e300 * np.eye(3), np.eye(2)]
)
def test_matrices_that_are_no_rotations_are_refused(refused: Refused, matrix: Any) -> None:
    assert (checks.rotation("x", np.eye(3)) == np.eye(3)).all()
    refused(lambda: checks.rotation("x", matrix), InvalidValue, "x must")
