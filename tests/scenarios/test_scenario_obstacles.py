"""[[obstacle]] tables of a scenario file."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest

from ffsms_pin import opt
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios import scenario

BASE = """
[robot]
model = "planar_3r"
[start]
joints_deg = [23.0, 40.0, -29.0]
[target]
position = [0.45, 0.75, 0.0]
[plan]
duration = 8.0
dt = 0.05
"""
CUBE = """v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"""
DENTED = CUBE.replace("v 0 0 0", "v 0.3 0.3 0.3") + "v -1 -1 -1\nf 1 2 5\nf 1 5 3\nf 2 3 5\n"


def test_every_shape_is_an_obstacle(tmp_path: Path) -> None:
    (tmp_path / "corner.obj").write_text(CUBE, encoding="utf-8")
    path = tmp_path / "around.toml"
    path.write_text(
        BASE
        + """
[[obstacle]]
shape = "sphere"
radius = 0.05
position = [0.69, 0.69, 0.0]
name = "antenna"
margin = 0.004
[[obstacle]]
shape = "box"
size = [0.1, 0.2, 0.3]
position = [-0.8, 0.0, 0.0]
rpy_deg = [0.0, 0.0, 90.0]
on = "base"
[[obstacle]]
shape = "cylinder"
radius = 0.1
length = 0.2
position = [3.0, 0.0, 0.0]
[[obstacle]]
shape = "capsule"
radius = 0.1
length = 0.2
position = [4.0, 0.0, 0.0]
[[obstacle]]
shape = "mesh"
file = "corner.obj"
scale = 0.1
position = [5.0, 0.0, 0.0]
[[limit]]
use = "clearance"
clearance = 0.012
""",
        encoding="utf-8",
    )
    read = scenario(path)
    sms = read.load()
    problem = read.problem(sms)
    (clearance,) = (limit for limit in problem.limits if isinstance(limit, opt.Clearance))
    assert clearance.clearance == 0.012
    ball, box, cylinder, capsule, mesh = clearance.obstacles
    assert [obstacle.name for obstacle in clearance.obstacles][:2] == ["antenna", "box 2"]
    assert ball.margin == 0.004
    assert box.on_base
    np.testing.assert_allclose(box.pose.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(2.0 * box.shape.halfSide, [0.1, 0.2, 0.3])
    assert isinstance(cylinder.shape, coal.Cylinder)
    assert capsule.shape.radius == 0.1
    assert mesh.distance(np.array([4.9, 0.01, 0.01]), 0.0) == pytest.approx(0.1, abs=1e-5)
    plan = opt.solve(problem)
    assert plan.reached, plan.note


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('shape = "box"', 'size is missing: shape = "box" needs it'),
        ("radius = 0.1", "shape is missing; it has no default"),
        ('shape = "sphere"\nradius = 0.1\nsize = [1.0, 1.0, 1.0]', 'size is no option of shape = "sphere"'),
        ('shape = "sphere"\nradius = 0.1\non = "moon"', 'must be one of "inertial", "base"'),
        ('shape = "mesh"\nfile = "absent.stl"', "file does not exist, got 'absent.stl'"),
        ('shape = "mesh"\nfile = "dented.obj"', "must be convex: cut it into convex pieces"),
        ('shape = "sphere"\nradius = 0.1\nposition = [0.45, 0.75, 0.0]', None),
    ],
)
def test_invalid_obstacles_are_refused(tmp_path: Path, table: str, message: str | None) -> None:
    (tmp_path / "dented.obj").write_text(DENTED, encoding="utf-8")
    path = tmp_path / "wrong.toml"
    path.write_text(f"{BASE}\n[[obstacle]]\n{table}\n", encoding="utf-8")
    if message is None:  # the target is inside
        read = scenario(path)
        with pytest.raises(ValueError, match="mm inside 'sphere 1'"):
            opt.solve(read.problem(read.load()))
        return
    with pytest.raises(InvalidScenario, match=message):
        _problem(path)


def _problem(path: Path) -> opt.Problem:
    read = scenario(path)
    return read.problem(read.load())
