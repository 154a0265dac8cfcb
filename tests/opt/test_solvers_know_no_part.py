"""The solvers know no term and no limit, neither by class nor by name, and plans do not depend on these."""

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
from part_cases import acting

import ffsms_pin as ffsms
from ffsms_pin import opt

ROOT = Path(opt.__file__).parent
# What users call, and what hands over to the solvers: these build parts from arguments, and ask none.
FRONT = {"plans.py", "replan/step_planner.py"}


def every_part() -> set[type]:
    """All terms and limits of the library."""
    for module in pkgutil.walk_packages([str(ROOT)], "ffsms_pin.opt."):
        importlib.import_module(module.name)
    ahead, found = [*opt.Term.__subclasses__(), *opt.Limit.__subclasses__()], set()
    while ahead:
        one = ahead.pop()
        ahead += one.__subclasses__()
        found |= {one} if one.__module__.startswith("ffsms_pin.opt.") else set()
    return found


PARTS = every_part()
CLASSES = {one.__name__ for one in PARTS}
NAMES = {name for one in PARTS if isinstance(name := getattr(one, "name", None), str) and name}


def solver_files() -> list[Path]:
    files = [*(ROOT / "search").glob("*.py"), *(ROOT / "step").glob("*.py"), *(ROOT / "replan").glob("*.py")]
    return sorted([*files, ROOT / "trajectory.py", ROOT / "plans.py"])


def classes_asked_for(tree: ast.AST) -> Iterator[str]:
    """Names in calls of isinstance and issubclass, and beside `type(x) is`."""
    for node in ast.walk(tree):
        asked = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass")
        of_type = isinstance(node, ast.Compare) and "type(" in ast.unparse(node)
        if asked or of_type:
            yield from (one.id for one in ast.walk(node) if isinstance(one, ast.Name))
            yield from (one.attr for one in ast.walk(node) if isinstance(one, ast.Attribute))


def imported(tree: ast.AST) -> Iterator[str]:
    """What is imported from the library's parts."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ffsms_pin.opt"):
            own = (node.module or "").startswith("ffsms_pin.opt.replan")  # re-planning has a term of its own
            yield from () if own else (one.name for one in node.names)


def texts(tree: ast.AST) -> Iterator[str]:
    """Text constants that are no docstrings."""
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said:
            yield node.value


def test_there_are_parts_and_solvers() -> None:
    assert {"Coupling", "JointLimits", "Clearance", "BaseLimits", "WheelLimits"} <= CLASSES
    assert {"coupling", "joints", "clearance", "wheels"} <= NAMES
    assert len(solver_files()) > 15


@pytest.mark.parametrize("path", solver_files(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_solver_knows_a_part(path: Path) -> None:
    tree, name = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(ROOT).as_posix()
    if name == "replan/options.py":
        return  # numbers, and a part itself
    # A waypoint may be given as its place, options of `plan` have names of a limit and a term, and a problem
    # that is re-planned gets the box of alpha.
    front = {"Waypoint", "via", "base", "effort", "clearance", "AlphaBox", "path"} if name in FRONT else set()
    front |= {"path"} if name == "trajectory.py" else set()  # it is judged along a path
    assert not CLASSES & set(classes_asked_for(tree)) - front
    assert name in FRONT or not CLASSES & set(imported(tree)) - front
    assert not NAMES & set(texts(tree)) - front


# What a limit says of itself beside its methods.
ASKED = (
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


def own_limit(limit: opt.Limit, called: str = "my own") -> opt.Limit:
    """A limit of the user's own, under another name, that answers what another one answers."""

    class Own(opt.Limit):
        def __init__(self, inner: opt.Limit) -> None:
            self.inner, self.name = inner, called
            for name in ASKED:
                setattr(self, name, getattr(inner, name))

        def for_robot(self, sms: ffsms.SpaceManipulator) -> opt.Limit:
            return Own(self.inner.for_robot(sms))

        def rows(self, step: Any) -> Any:
            return self.inner.rows(step)

        def residual(self, motions: Any) -> Any:
            return self.inner.residual(motions)

        def violation(self, motion: Any) -> opt.Violation:
            return self.inner.violation(motion)

    return Own(limit)


def own_term(term: opt.Term) -> opt.Term:
    """The same of a term."""

    class Own(opt.Term):
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

    return Own()


def ball(x: float, y: float) -> opt.Obstacle:
    return opt.Obstacle(coal.Sphere(0.05), pin.SE3(np.eye(3), np.array([x, y, 0.0])))


def tight(sms: ffsms.SpaceManipulator, **limits: float) -> ffsms.SpaceManipulator:
    return sms.with_limits(replace(sms.limits, **{name: np.full(3, x) for name, x in limits.items()}))


# What is limited, and the robot as it has to be for that to bind.
LIMITS: dict[str, tuple[opt.Limit, Callable[[ffsms.SpaceManipulator], ffsms.SpaceManipulator]]] = {
    "joints": (opt.JointLimits(), lambda sms: sms),
    "torques": (opt.TorqueLimits(), lambda sms: tight(sms, torque=0.01)),
    "clearance": (opt.Clearance(obstacles=[ball(0.8, 0.15)]), lambda sms: sms),
    "base": (opt.BaseLimits(0.15, 0.1, 0.05, 0.05), lambda sms: sms),
    "wheels": (opt.WheelLimits(), lambda sms: acting(sms, momentum=0.03, torque=0.02)),
    "alpha box": (opt.AlphaBox(), lambda sms: tight(sms, velocity=5.0, acceleration=50.0)),
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
    ours, other = plans
    np.testing.assert_array_equal(other.joint_rates, ours.joint_rates)
    np.testing.assert_array_equal(other.base_rotation, ours.base_rotation)
    assert (other.reached, other.note, other.kappa) == (ours.reached, ours.note, ours.kappa)
    assert list(other.shares) == [names.get(key, key) for key in ours.shares]
    assert list(other.shares.values()) == list(ours.shares.values())
    assert [names.get(key, key) for key in ours.binding] == list(other.binding)


@pytest.mark.slow
@pytest.mark.parametrize("which", [*LIMITS, *TERMS])
def test_a_part_of_ones_own_gives_the_same_plan(planar: ffsms.SpaceManipulator, which: str) -> None:
    part, robot = LIMITS.get(which, (None, acting))
    sms, name = robot(planar), which.partition(",")[0]
    mode = {"wheels": "rotation-floating", "wheel energy": "rotation-floating", "propellant": "flying"}
    parts: list[opt.Limit] = [opt.JointLimits(), opt.Clearance()]
    limits = [one for one in parts if part is None or one.name != name] + ([part] if part else [])
    terms: list[opt.Term] = [one for one in (opt.Coupling(), opt.Smooth(), opt.Effort()) if one.name != which]
    terms += [TERMS[which]] if which in TERMS else []
    plans, goal = [], [0.75, 0.5, 0.0]
    for own in (False, True):
        # Of wheels' own limits the problem adds one by that name where it is not there.
        kept = [
            own_limit(one, name if name == "wheels" else "my own") if own and one is part else one
            for one in limits
        ]
        sought = [own_term(one) if own and one is TERMS.get(which) else one for one in terms]
        q0 = sms.configuration([0.2, 0.4, -0.3])
        duration = {"alpha box": 0.8, "joints": 3.0}.get(which, 6.0)
        problem = opt.Problem(
            sms, q0, goal, duration, duration / 120, sought, kept, mode=mode.get(which, "floating")
        )
        plans.append(opt.solve(problem))
    same(plans, {} if name == "wheels" else {name: "my own"})
    assert part is None or name in plans[0].binding or name in ("also", "via")  # which are passed well inside


class Turn(opt.Inequality):
    """The base turns by no more than 0.15 rad, as `opt.BaseLimits` has it; attributes as documented."""

    name, unit, holds_attitude, of_paper = "base", "rad", True, False
    margin, scale, absolute_margin, softness, trusted = 0.03 * 0.08, 0.15 / 0.03, 0.08 * 0.15, 0.1, 0.02

    def slack(self, m: opt.Variables) -> Any:
        return 0.15 - m.base.angle_from(m.rotation_start)


class Weak(opt.Inequality):
    """Joints of 0.01 N m, as `opt.TorqueLimits` has it."""

    name, eased_by_time = "torques", True
    margin, scale, absolute_margin, largest_extra_margin = 0.03 * 0.08, 1.0 / 0.03, 0.08, 0.5 - 0.08

    def slack(self, m: opt.Variables) -> Any:
        return 1.0 - abs(m.torques) / np.full(3, 0.01)


@pytest.mark.parametrize(("limit", "formula"), [(opt.BaseLimits(0.15), Turn()), (opt.TorqueLimits(), Weak())])
def test_a_formula_of_ones_own_gives_the_same_plan(
    planar: ffsms.SpaceManipulator, limit: opt.Limit, formula: opt.Limit
) -> None:
    sms, plans = tight(planar, torque=0.01), []
    for one in (limit, formula):
        q0 = sms.configuration([0.2, 0.4, -0.3])
        problem = opt.Problem(sms, q0, [0.75, 0.5, 0.0], 6.0, 0.02, limits=[opt.JointLimits(), one])
        plans.append(opt.solve(problem))
    assert plans[0].reached
    np.testing.assert_array_equal(plans[1].joint_rates, plans[0].joint_rates)


def test_a_corridor_of_ones_own_gives_the_same_plan() -> None:
    panda = ffsms.load("satellite_panda")
    q0 = panda.home()
    tip = panda.at(q0).end_effector_pose

    class Mine(opt.Meet):
        def limits(self, duration: float) -> tuple[opt.Limit, ...]:
            return tuple(own_limit(one, one.name) for one in super().limits(duration))

    plans = []
    for kind in (opt.Meet, Mine):
        grasp = pin.SE3(tip.rotation, tip.translation + np.array([0.05, 0.05, 0.0]))
        client = ffsms.Client(30.0, np.diag([1.0, 1.2, 1.5]), grasp, [0.002, 0.0, 0.0, 0.0, 0.0, 0.01])
        limits = [opt.JointLimits()]
        plans.append(opt.solve(opt.Problem(panda, q0, kind(client), 12.0, 0.1, limits=limits)))
    same(plans, {})
    assert "corridor" in plans[0].binding
