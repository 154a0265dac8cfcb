"""Test that objects with arrays can be compared and hashed without an error."""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import control, opt
from ffsms_pin.errors import DependencyMissing
from ffsms_pin.simulation import Actuator, Tracking, Wrench


def dataclasses() -> Iterator[type]:
    """Yield all dataclasses of the package, public or not."""
    for module_info in pkgutil.walk_packages(ffsms.__path__, "ffsms_pin.", onerror=lambda _: None):
        if module_info.name.endswith("__main__"):
            continue
        try:
            module = import_module(module_info.name)
        except DependencyMissing:
            continue
        for kind in vars(module).values():
            if (
                inspect.isclass(kind)
                and is_dataclass(kind)
                and kind.__module__ == module.__name__
                and not inspect.isabstract(kind)
            ):
                yield kind


def hard_to_compare(annotation: str) -> Any:
    """Return a value of this type that is hard to compare."""
    array = np.arange(3.0)
    if annotation.startswith("Callable"):
        return len
    if re.search(r"dict|Mapping", annotation):
        return {"a": array}
    if re.search(r"Sequence|tuple\[.*(Array|Any)|list", annotation):
        return (array, array)
    return array if re.search(r"Array|\bAny\b|SE3|object", annotation) else 1.0


def comparison_error(kind: Any) -> str:
    """Return the error if two objects with the same values are compared, or one is hashed."""
    first, second = object.__new__(kind), object.__new__(kind)
    for field in fields(kind):
        for instance in (first, second):
            object.__setattr__(instance, field.name, hard_to_compare(str(field.type)))
    try:
        results = [first == first, first == second, first != second]
        if kind.__hash__ is not None:  # mutable dataclasses are not hashable on purpose
            hash(first)
    except (TypeError, ValueError) as error:
        return f"{kind.__module__}.{kind.__qualname__}: {error}"
    return "" if results[0] is True and all(isinstance(answer, bool) for answer in results) else str(results)


def test_every_dataclass_with_arrays_can_be_compared_and_hashed() -> None:
    kinds = set(dataclasses()) - {ffsms.SatelliteBase}  # it has numbers only, so it compares by value
    assert len(kinds) > 80
    assert [problem for problem in map(comparison_error, kinds) if problem] == []


def test_results_are_compared_by_identity(
    planar: ffsms.SpaceManipulator, swung: Tracking, tmp_path: Path
) -> None:
    plan = opt.plan(planar, planar.configuration([0.3, 0.6, 0.5]), [0.7, 0.3, 0.0], 2.0, 0.1, method="step")
    plan.save(tmp_path / "plan.npz")
    swung.save(tmp_path / "run.npz")
    client = ffsms.Client(10.0, np.eye(3), pose=pin.SE3.Identity(), twist=np.zeros(6))
    for first, second in [
        (plan, opt.Trajectory.load(tmp_path / "plan.npz")),
        (swung, Tracking.load(tmp_path / "run.npz")),
        (planar.at(plan.q[0]), planar.at(plan.q[0])),
        (planar.batch(plan.joint_positions), planar.batch(plan.joint_positions)),
        (client, ffsms.Client(10.0, np.eye(3), pose=pin.SE3.Identity(), twist=np.zeros(6))),
        (Actuator(torque_limit=np.ones(3)), Actuator(torque_limit=np.ones(3))),
        (Wrench(np.ones(6)), Wrench(np.ones(6))),
        (control.PD(planar), control.PD(planar)),
    ]:
        assert first == first
        assert first != second
        assert len({first, second}) == 2
