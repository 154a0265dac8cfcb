"""The solvers know no term and no limit, neither by class nor by name, and plans do not depend on these."""

from __future__ import annotations

import ast
import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.limits.limit import later, tightened

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
    files = [*(ROOT / "horizon").glob("*.py"), *(ROOT / "step").glob("*.py"), *(ROOT / "replan").glob("*.py")]
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
    assert len(solver_files()) > 20


@pytest.mark.parametrize("path", solver_files(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_solver_knows_a_part(path: Path) -> None:
    tree, name = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(ROOT).as_posix()
    if name == "replan/options.py":
        return  # numbers, and a part itself
    front = {"Via", "via"} if name in FRONT else set()  # a waypoint may be given as its place
    assert not CLASSES & set(classes_asked_for(tree)) - front
    assert name in FRONT or not CLASSES & set(imported(tree))
    assert not NAMES & set(texts(tree)) - front


# What a limit says of itself beside its methods.
ASKED = (
    "margin",
    "reserve",
    "began",
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


def own_limit(limit: opt.Limit) -> opt.Limit:
    """A limit of the user's own, under another name, that answers what another one answers."""

    class Own(opt.Limit):
        def __init__(self, inner: opt.Limit) -> None:
            self.inner, self.name = inner, "my own"
            for name in ASKED:
                setattr(self, name, getattr(inner, name))

        def for_robot(self, sms: ffsms.SpaceManipulator) -> opt.Limit:
            return Own(self._now().for_robot(sms))

        def _now(self) -> opt.Limit:
            now = tightened(self.inner, self.reserve - self.inner.reserve)
            return later(now, self.began - now.began)

        def rows(self, step: Any) -> Any:
            return self._now().rows(step)

        def residual(self, motions: Any) -> Any:
            return self._now().residual(motions)

        def violation(self, motion: Any) -> opt.Violation:
            return self._now().violation(motion)

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


LIMITS = {
    "joints": opt.JointLimits(),
    "clearance": opt.Clearance(obstacles=[ball(0.8, 0.15)]),
    "base": opt.BaseLimits(attitude=0.15, final_attitude=0.05),
    "also": opt.Also("joint_3", [0.63, 0.32, 0.0]),
    "via": opt.Via([0.85, 0.3, 0.0], reach=0.05),
}


@pytest.mark.parametrize("which", [*LIMITS, "coupling"])
def test_a_part_of_ones_own_gives_the_same_plan(planar: ffsms.SpaceManipulator, which: str) -> None:
    terms: list[opt.Term] = [opt.Coupling(), opt.Smooth(), opt.Effort()]
    limits = [opt.JointLimits(), opt.Clearance()]
    if which != "coupling":
        limits = [one for one in limits if one.name != which] + [LIMITS[which]]
    plans = []
    for own in (False, True):
        kept = [own_limit(one) if own and one is LIMITS.get(which) else one for one in limits]
        sought = [own_term(one) if own and one.name == which else one for one in terms]
        q0 = planar.configuration([0.2, 0.4, -0.3])
        problem = opt.Problem(planar, q0, [0.75, 0.5, 0.0], 6.0, 0.05, terms=sought, limits=kept)
        plans.append(opt.solve(problem))
    ours, other = plans
    np.testing.assert_array_equal(other.joint_rates, ours.joint_rates)
    np.testing.assert_array_equal(other.base_rotation, ours.base_rotation)
    assert (other.reached, other.note, other.kappa) == (ours.reached, ours.note, ours.kappa)
    renamed = ["my own" if key == which else key for key in ours.shares]
    assert list(other.shares) == renamed
    assert list(other.shares.values()) == list(ours.shares.values())
