"""Solvers refer to no term or limit by class or name, and plans do not depend on classes and names."""

from __future__ import annotations

import ast
import importlib
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from part_cases import with_wheels_and_thrusters

import ffsms_pin as ffsms
from ffsms_pin import opt

ROOT = Path(opt.__file__).parent
# The user interface builds terms and limits from arguments.
INTERFACE = {"plans.py", "replan/step_planner.py"}


def all_parts() -> set[type]:
    """Return all terms and limits of the library."""
    for module in pkgutil.walk_packages([str(ROOT)], "ffsms_pin.opt."):
        importlib.import_module(module.name)
    pending, parts = [*opt.Term.__subclasses__(), *opt.Limit.__subclasses__()], set()
    while pending:
        part = pending.pop()
        pending += part.__subclasses__()
        parts |= {part} if part.__module__.startswith("ffsms_pin.opt.") else set()
    return parts


PARTS = all_parts()
CLASSES = {part.__name__ for part in PARTS}
NAMES = {name for part in PARTS if isinstance(name := getattr(part, "name", None), str) and name}


def solver_files() -> list[Path]:
    files = [*(ROOT / "search").glob("*.py"), *(ROOT / "step").glob("*.py"), *(ROOT / "replan").glob("*.py")]
    options = ROOT / "replan" / "options.py"  # defines terms of re-planning
    return sorted([*(path for path in files if path != options), ROOT / "trajectory.py", ROOT / "plans.py"])


def compared_classes(tree: ast.AST) -> Iterator[str]:
    """Yield names in calls of isinstance and issubclass, and beside `type(x) is`."""
    for node in ast.walk(tree):
        is_check = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass")
        of_type = isinstance(node, ast.Compare) and "type(" in ast.unparse(node)
        if is_check or of_type:
            yield from (child.id for child in ast.walk(node) if isinstance(child, ast.Name))
            yield from (child.attr for child in ast.walk(node) if isinstance(child, ast.Attribute))


def imported_parts(tree: ast.AST) -> Iterator[str]:
    """Yield names that are imported from `ffsms_pin.opt`, except from re-planning."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ffsms_pin.opt"):
            internal = (node.module or "").startswith("ffsms_pin.opt.replan")  # re-planning has its own term
            yield from () if internal else (alias.name for alias in node.names)


def string_constants(tree: ast.AST) -> Iterator[str]:
    """Yield string constants that are no docstrings."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


def test_parts_and_solvers_are_listed() -> None:
    assert {"Coupling", "JointLimits", "Clearance", "BaseLimits", "WheelLimits"} <= CLASSES
    assert {"coupling", "joints", "clearance", "wheels"} <= NAMES
    assert len(solver_files()) > 15


@pytest.mark.parametrize("path", solver_files(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_solvers_refer_to_no_part(path: Path) -> None:
    tree, name = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(ROOT).as_posix()
    # Waypoints may be positions, options of `plan` have names of a limit and a term, and re-planned problems
    # get the box of alpha.
    allowed = (
        {"Waypoint", "via", "base", "effort", "clearance", "AlphaBox", "path"} if name in INTERFACE else set()
    )
    allowed |= {"path"} if name == "trajectory.py" else set()  # motions are judged along a path
    assert not CLASSES & set(compared_classes(tree)) - allowed
    assert name in INTERFACE or not CLASSES & set(imported_parts(tree)) - allowed
    assert not NAMES & set(string_constants(tree)) - allowed


# The attributes of a limit.
LIMIT_ATTRIBUTES = (
    "margin",
    "ends",
    "joint_bounds",
    "in_braking",
    "refusal",
    "blocks",
    "obstacles",
    "holds_attitude",
    "eased_by_time",
    "of_paper",
)


def custom_limit(limit: opt.Limit, name_: str = "my own") -> opt.Limit:
    """Return a custom limit under another name that delegates to `limit`."""

    class Custom(opt.Limit):
        def __init__(self, inner: opt.Limit) -> None:
            self.inner, self.name = inner, name_
            for name in LIMIT_ATTRIBUTES:
                setattr(self, name, getattr(inner, name))

        def for_robot(self, sms: ffsms.SpaceManipulator) -> opt.Limit:
            return Custom(self.inner.for_robot(sms))

        def rows(self, step: Any) -> Any:
            return self.inner.rows(step)

        def residual(self, motions: Any) -> Any:
            return self.inner.residual(motions)

        def violation(self, motion: Any) -> opt.Violation:
            return self.inner.violation(motion)

    return Custom(limit)


def custom_term(term: opt.Term) -> opt.Term:
    """Return a custom term that delegates to `term`."""

    class Custom(opt.Term):
        name = "my own"

        measures_cost, kappa, smooths = term.measures_cost, term.kappa, term.smooths
        tie_breaker = term.tie_breaker

        def residual(self, motions: Any) -> Any:
            return term.residual(motions)

        def step_objective(self, step: Any) -> Any:
            return term.step_objective(step)

        def cost(self, motions: Any) -> Any:
            return term.cost(motions)

        def share(self, motion: Any) -> float:
            return term.share(motion)

    return Custom()


def ball(x: float, y: float) -> opt.Obstacle:
    return opt.Obstacle(coal.Sphere(0.05), pin.SE3(np.eye(3), np.array([x, y, 0.0])))


def limited_robot(sms: ffsms.SpaceManipulator, **limits: float) -> ffsms.SpaceManipulator:
    return sms.with_limits(replace(sms.limits, **{name: np.full(3, x) for name, x in limits.items()}))


# A limit, and a robot for which the limit is active.
LIMITS: dict[str, tuple[opt.Limit, Callable[[ffsms.SpaceManipulator], ffsms.SpaceManipulator]]] = {
    "joints": (opt.JointLimits(), lambda sms: sms),
    "torques": (opt.TorqueLimits(), lambda sms: limited_robot(sms, torque=0.01)),
    "clearance": (opt.Clearance(obstacles=[ball(0.8, 0.15)]), lambda sms: sms),
    "base": (opt.BaseLimits(0.15, 0.1, 0.05, 0.05), lambda sms: sms),
    "wheels": (opt.WheelLimits(), lambda sms: with_wheels_and_thrusters(sms, momentum=0.03, torque=0.02)),
    "alpha box": (opt.AlphaBox(), lambda sms: limited_robot(sms, velocity=5.0, acceleration=50.0)),
    "also": (opt.FrameGoal("joint_3", [0.63, 0.32, 0.0]), lambda sms: sms),
    "via": (opt.Waypoint([0.85, 0.3, 0.0], reach=0.05), lambda sms: sms),
    "via, timed": (opt.Waypoint([0.85, 0.3, 0.0], time=3.0, reach=0.05), lambda sms: sms),
}
TERMS: dict[str, opt.Term] = {
    "coupling": opt.Coupling(),
    "smooth": opt.Smooth(),
    "effort": opt.Effort(),
    "base turn": opt.BaseTurn(),
    "wheel energy": opt.WheelEnergy(),
    "propellant": opt.Propellant(),
}


def same(plans: list[opt.Trajectory], names: dict[str, str]) -> None:
    packaged, other = plans
    np.testing.assert_array_equal(other.joint_rates, packaged.joint_rates)
    np.testing.assert_array_equal(other.base_rotation, packaged.base_rotation)
    assert (other.reached, other.note, other.kappa) == (packaged.reached, packaged.note, packaged.kappa)
    assert list(other.shares) == [names.get(key, key) for key in packaged.shares]
    assert list(other.shares.values()) == list(packaged.shares.values())
    assert [names.get(key, key) for key in packaged.binding] == list(other.binding)


@pytest.mark.slow
@pytest.mark.parametrize("part_name", [*LIMITS, *TERMS])
def test_a_custom_part_gives_the_same_plan(planar: ffsms.SpaceManipulator, part_name: str) -> None:
    part, robot = LIMITS.get(part_name, (None, with_wheels_and_thrusters))
    sms, name = robot(planar), part_name.partition(",")[0]
    mode = {"wheels": "rotation-floating", "wheel energy": "rotation-floating", "propellant": "flying"}
    parts: list[opt.Limit] = [opt.JointLimits(), opt.Clearance()]
    limits = [limit for limit in parts if part is None or limit.name != name] + ([part] if part else [])
    terms: list[opt.Term] = [
        term for term in (opt.Coupling(), opt.Smooth(), opt.Effort()) if term.name != part_name
    ]
    terms += [TERMS[part_name]] if part_name in TERMS else []
    plans, goal = [], [0.75, 0.5, 0.0]
    for custom in (False, True):
        # The problem adds wheel limits unless a limit has their name.
        chosen_limits = [
            custom_limit(limit, name if name == "wheels" else "my own") if custom and limit is part else limit
            for limit in limits
        ]
        chosen_terms = [
            custom_term(term) if custom and term is TERMS.get(part_name) else term for term in terms
        ]
        q0 = sms.configuration([0.2, 0.4, -0.3])
        duration = {"alpha box": 0.8, "joints": 3.0}.get(part_name, 6.0)
        problem = opt.Problem(
            sms,
            q0,
            goal,
            duration,
            duration / 120,
            chosen_terms,
            chosen_limits,
            mode=mode.get(part_name, "floating"),
        )
        plans.append(opt.solve(problem))
    same(plans, {} if name == "wheels" else {name: "my own"})
    assert (
        part is None or name in plans[0].binding or name in ("also", "via")
    )  # the last two are met with slack


class BaseAttitudeLimit(opt.Inequality):
    """The limit of `opt.BaseLimits(0.15)` as a formula with the documented attributes."""

    name, unit, holds_attitude, of_paper = "base", "rad", True, False
    margin, scale, absolute_margin, softness, trusted = 0.03 * 0.08, 0.15 / 0.03, 0.08 * 0.15, 0.1, 0.02

    def slack(self, m: opt.Variables) -> Any:
        return 0.15 - m.base.angle_from(m.rotation_start)


class TorqueLimit(opt.Inequality):
    """The limit of `opt.TorqueLimits` as a formula, for joints of 0.01 N m."""

    name, eased_by_time = "torques", True
    margin, scale, absolute_margin, largest_extra_margin = 0.03 * 0.08, 1.0 / 0.03, 0.08, 0.5 - 0.08

    def slack(self, m: opt.Variables) -> Any:
        return 1.0 - abs(m.torques) / np.full(3, 0.01)


@pytest.mark.parametrize(
    ("limit", "formula"), [(opt.BaseLimits(0.15), BaseAttitudeLimit()), (opt.TorqueLimits(), TorqueLimit())]
)
def test_a_custom_formula_gives_the_same_plan(
    planar: ffsms.SpaceManipulator, limit: opt.Limit, formula: opt.Limit
) -> None:
    sms, plans = limited_robot(planar, torque=0.01), []
    for limit_ in (limit, formula):
        q0 = sms.configuration([0.2, 0.4, -0.3])
        problem = opt.Problem(sms, q0, [0.75, 0.5, 0.0], 6.0, 0.02, limits=[opt.JointLimits(), limit_])
        plans.append(opt.solve(problem))
    assert plans[0].reached
    np.testing.assert_array_equal(plans[1].joint_rates, plans[0].joint_rates)


def test_a_custom_corridor_gives_the_same_plan() -> None:
    panda = ffsms.load("satellite_panda")
    q0 = panda.home()
    tip = panda.at(q0).end_effector_pose

    class CustomMeet(opt.Meet):
        def limits(self, duration: float) -> tuple[opt.Limit, ...]:
            return tuple(custom_limit(limit, limit.name) for limit in super().limits(duration))

    plans = []
    for kind in (opt.Meet, CustomMeet):
        grasp = pin.SE3(tip.rotation, tip.translation + np.array([0.05, 0.05, 0.0]))
        client = ffsms.Client(30.0, np.diag([1.0, 1.2, 1.5]), grasp, [0.002, 0.0, 0.0, 0.0, 0.0, 0.01])
        limits = [opt.JointLimits()]
        plans.append(opt.solve(opt.Problem(panda, q0, kind(client), 12.0, 0.1, limits=limits)))
    same(plans, {})
    assert "corridor" in plans[0].binding
