"""Test numbers, poses, colours and errors of the shapes of robots."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt, robot
from ffsms_pin.errors import FfsmsError, FfsmsWarning, GeometryError, InvalidValue
from ffsms_pin.urdf import model_names, model_path

Refused = Callable[..., FfsmsError]


def test_numbers_of_shapes_of_named_robots() -> None:
    shapes = {
        "planar_3r": (4, 4),
        "servicer": (11, 11),
        "space_arm_7": (10, 8),  # the panels are drawn only
        "two_arms": (15, 15),
        "satellite_xarm7": (9, 9),
        "satellite_panda": (12, 18),
    }
    assert set(shapes) <= {*model_names(), *robot.satellite_names()}
    for name, (visual, collision) in shapes.items():
        sms = ffsms.load(name, end_effector="left_tool" if name == "two_arms" else None)
        assert (sms.geometry("visual").ngeoms, sms.geometry("collision").ngeoms) == (visual, collision)
        assert sms.geometry("visual") is sms.geometry("visual")


def test_only_neighbours_touch_at_rest() -> None:
    # Shapes of links that no joint connects must not touch, so every shape is at its link.
    for name, joints in (("space_arm_7", 0.4), ("two_arms", 0.3)):
        sms = ffsms.load(name, end_effector="left_tool" if name == "two_arms" else None)
        shapes = sms.geometry("collision").copy()
        shapes.addAllCollisionPairs()
        data, places = sms.model.createData(), pin.GeometryData(shapes)
        pin.updateGeometryPlacements(
            sms.model, data, shapes, places, sms.configuration(np.full(sms.n, joints), pin.SE3.Identity())
        )
        for k, pair in enumerate(shapes.collisionPairs):
            a, b = (shapes.geometryObjects[i].parentJoint for i in (pair.first, pair.second))
            joined = sms.model.parents[a] == b or sms.model.parents[b] == a
            assert pin.computeCollision(shapes, places, k) == joined, (a, b)


def test_panels_are_drawn_only() -> None:
    sms = ffsms.mount("planar_3r", ffsms.SatelliteBase(panels=(2.0, 0.5)))
    plain = ffsms.mount("planar_3r")
    assert sms.geometry("visual").ngeoms == plain.geometry("visual").ngeoms + 2
    assert sms.geometry("collision").ngeoms == plain.geometry("collision").ngeoms
    panels = [g for g in sms.geometry("visual").geometryObjects if abs(g.placement.translation[1]) > 1.0]
    np.testing.assert_allclose([abs(g.placement.translation[1]) for g in panels], 1.6)


def test_shapes_of_copies() -> None:
    sms = ffsms.mount("planar_3r")
    sms.geometry("visual")
    for again in (copy.copy(sms), copy.deepcopy(sms), pickle.loads(pickle.dumps(sms))):
        assert again.geometry("visual").ngeoms == sms.geometry("visual").ngeoms


def test_missing_and_damaged_meshes_are_reported(refused: Refused, tmp_path: Path) -> None:
    text = model_path("planar_3r").read_text()
    path = tmp_path / "a.urdf"
    path.write_text(text.replace('<box size="0.3 0.03 0.03"/>', '<mesh filename="package://robot/arm.stl"/>'))
    sms = ffsms.load(path)
    refused(lambda: sms.geometry("collision"), GeometryError, "package://robot/arm.stl", "package_dirs")
    with pytest.warns(
        FfsmsWarning, match=r"visual meshes are missing: 'package://robot/arm\.stl'; .* not drawn"
    ) as recorded:
        assert sms.geometry("visual").ngeoms == 1  # three links have the mesh
    assert len(recorded) == 1
    kind: Any = "drawn"
    refused(lambda: sms.geometry(kind), InvalidValue, "kind")
    bare = ffsms.SpaceManipulator(sms.model, "link_3")
    refused(lambda: bare.geometry("visual"), GeometryError, "URDF")
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "arm.stl").write_text("no mesh")
    refused(lambda: ffsms.load(path).geometry("collision"), GeometryError, "cannot be built")


@pytest.mark.parametrize(
    ("shape", "fragment"),
    [
        ('<cylinder length="1"/>', "no radius"),
        ('<cylinder radius="x" length="1"/>', 'radius="x"'),
        ('<sphere radius="-0.1"/>', 'radius="-0.1"'),
        ('<sphere radius="0.1 0.2"/>', "1 number above zero"),
        ('<capsule radius="0.1" length="0.2"/>', "<capsule>"),
        ('<mesh filename="a.stl" scale="1 1"/>', 'scale="1 1"'),
        ('<sphere radius="1"/><sphere radius="2"/>', "2 geometries"),
        ("", "0 geometries"),
    ],
)
def test_no_shape_is_dropped_in_silence(
    refused: Refused, tmp_path: Path, capfd: pytest.CaptureFixture[str], shape: str, fragment: str
) -> None:
    # Pinocchio's parser omits such a shape, so that collisions with it would not be detected.
    start = '<collision><origin xyz="0.15 0 0"/><geometry>'
    text = model_path("planar_3r").read_text()
    path = tmp_path / "a.urdf"
    path.write_text(text.replace(start + '<box size="0.3 0.03 0.03"/>', start + shape, 1))
    sms = ffsms.load(path)
    refused(lambda: sms.geometry("collision"), GeometryError, "link_1", "collision", fragment)
    assert sms.geometry("visual").ngeoms == 4
    assert capfd.readouterr().err == ""


def test_colours() -> None:
    base, arm = ffsms.load("planar_3r").geometry("visual").geometryObjects[:2]
    np.testing.assert_allclose(base.meshColor, [0.80, 0.78, 0.72, 1.0])
    np.testing.assert_allclose(arm.meshColor, [0.20, 0.42, 0.63, 1.0])


TETRAHEDRON = "solid t\n" + "".join(
    "facet normal 0 0 0\nouter loop\n"
    + "".join(f"vertex {corner}\n" for corner in corners)
    + "endloop\nendfacet\n"
    for corners in (
        ("0 0 0", "0 1 0", "1 0 0"),
        ("0 0 0", "1 0 0", "0 0 1"),
        ("0 0 0", "0 0 1", "0 1 0"),
        ("1 0 0", "0 1 0", "0 0 1"),
    )
)


@pytest.mark.parametrize("name", ["package://robot/arm.stl", "robot/arm.stl", "robot\\arm.stl"])
def test_meshes_are_found_beside_the_file_or_in_package_folders(tmp_path: Path, name: str) -> None:
    text = model_path("planar_3r").read_text()
    files = tmp_path / "files"
    for folder in (files / "robot", tmp_path / "elsewhere" / "robot"):
        folder.mkdir(parents=True)
        (folder / "arm.stl").write_text(TETRAHEDRON + "endsolid t\n")
    path = files / "a.urdf"
    path.write_text(text.replace('<box size="0.3 0.03 0.03"/>', f'<mesh filename="{name}"/>'))
    assert ffsms.load(path).geometry("collision").ngeoms == 4
    assert ffsms.mount(path).geometry("collision").ngeoms == 5
    if name.startswith("package"):
        lone = tmp_path / "lone.urdf"
        lone.write_text(path.read_text())
        with pytest.raises(GeometryError):
            ffsms.load(lone).geometry("collision")
        folders = [tmp_path / "elsewhere"]
        assert ffsms.load(lone, package_dirs=folders).geometry("visual").ngeoms == 4
        assert ffsms.mount(lone, package_dirs=folders).geometry("visual").ngeoms == 5


@pytest.mark.parametrize("height", [0.0, 1e-9])
def test_a_flat_mesh_is_refused_as_an_obstacle_and_boxed_as_a_link(tmp_path: Path, height: float) -> None:
    """The library that computes hulls crashes for coplanar points."""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, height), (0.0, 1.0, 0.0)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 2 3", "f 1 3 4"]
    (tmp_path / "plate.obj").write_text("\n".join(lines) + "\n")
    with pytest.raises(InvalidValue, match=r"must be a mesh with a volume; give a thin coal\.Box"):
        opt.Obstacle.mesh(tmp_path / "plate.obj")
    text = (
        model_path("planar_3r")
        .read_text()
        .replace('<box size="0.3 0.03 0.03"/>', '<mesh filename="plate.obj"/>')
    )
    (tmp_path / "arm.urdf").write_text(text)
    sms = ffsms.load(tmp_path / "arm.urdf")
    plate = next(part for part in sms.convex_parts() if part.body == 0)
    np.testing.assert_allclose(2.0 * plate.half[:2], [1.0, 1.0])
