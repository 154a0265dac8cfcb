"""Test shapes that are passed with a Pinocchio model or read from an MJCF file."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from link_sums import arm_file
from motions import Array

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue, UnsupportedJoint
from ffsms_pin.geometry.bodies import chosen_mode
from ffsms_pin.geometry.shapes import ShapeKind, visual_shapes
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]
PLACE = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, -0.5), np.array([0.6, 0.1, 0.2]))
KINDS: dict[ShapeKind, Any] = {"visual": pin.GeometryType.VISUAL, "collision": pin.GeometryType.COLLISION}

MJCF = """<mujoco model="two"><compiler angle="radian"/><worldbody><body name="foot">
<inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.1 0.1"/>
<geom type="box" size="0.1 0.1 0.02" pos="0 0 0.05"/>
<body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 0 1" range="-1 1"/>
<inertial pos="0 0 0.2" mass="1.5" diaginertia="0.03 0.02 0.01"/>
<geom type="capsule" size="0.05 0.15" pos="0 0 0.2"/>
<body name="lower" pos="0 0 0.4"><joint name="elbow" axis="0 1 0" range="-2 2"/>
<inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.02 0.03"/>
<geom type="box" size="0.05 0.04 0.2" pos="0 0 0.2"/><site name="tool" pos="0 0 0.4"/>
</body></body></body></worldbody></mujoco>"""


def model_with_shapes(name: str) -> tuple[Any, dict[str, Any]]:
    path = arm_file(name)
    model = pin.buildModelFromUrdf(str(path))
    folder = [str(path.parents[4])]
    return model, {
        k: pin.buildGeomFromUrdf(model, str(path), kind, package_dirs=folder) for k, kind in KINDS.items()
    }


def placed(sms: ffsms.SpaceManipulator, kind: ShapeKind, q: Array) -> list[Array]:
    """Return the corners (6,) of the box of each shape in inertial axes, sorted."""
    shapes = sms.geometry(kind)
    data, scratch = pin.GeometryData(shapes), sms.model.createData()
    pin.updateGeometryPlacements(sms.model, scratch, shapes, data, q)
    rows = []
    for item, pose in zip(shapes.geometryObjects, data.oMg, strict=True):
        item.geometry.computeLocalAABB()
        box = item.geometry.aabb_local
        rows.append(np.concatenate([pose.act(np.array(box.min_)), pose.act(np.array(box.max_))]))
    return sorted(rows, key=lambda row: [round(float(x), 6) for x in row])


@pytest.mark.parametrize("locked", [{}, {"joint1": -0.3}])
def test_shapes_of_a_model_equal_those_of_its_urdf(locked: dict[str, float]) -> None:
    model, shapes = model_with_shapes("xarm7")
    base = ffsms.SatelliteBase(300.0, (1.2, 1.0, 0.8), panels=(2.0, 0.8))
    from_model = ffsms.mount(model, base, PLACE, locked=locked, velocity=0.4, **shapes)
    from_urdf = ffsms.mount("xarm7", base, PLACE, locked=locked, velocity=0.4)
    q = from_urdf.configuration(np.linspace(-0.4, 0.7, from_urdf.n))
    for kind in KINDS:
        np.testing.assert_allclose(placed(from_model, kind, q), placed(from_urdf, kind, q), atol=1e-9)
    pickled = pickle.dumps(from_model)
    assert len(pickled) < 100_000  # a pickle has the names of meshes, not their triangles
    again = pickle.loads(pickled)
    for kind in KINDS:
        np.testing.assert_allclose(placed(again, kind, q), placed(from_model, kind, q), atol=1e-12)
        pairs = zip(
            again.geometry(kind).geometryObjects, from_model.geometry(kind).geometryObjects, strict=True
        )
        for first, second in pairs:
            np.testing.assert_array_equal(first.meshColor, second.meshColor)
            assert (first.name, first.meshPath) == (second.name, second.meshPath)
            assert first.overrideMaterial == second.overrideMaterial


def test_collision_checks_use_the_shapes_of_a_model() -> None:
    """With shapes, clearances are computed from hulls; without shapes, from the paper's points."""
    model, shapes = model_with_shapes("xarm7")
    plain, seen = ffsms.mount(model, velocity=0.4), ffsms.mount(model, velocity=0.4, **shapes)
    assert [chosen_mode(sms) for sms in (plain, seen)] == ["points", "hulls"]


def test_collision_shapes_are_drawn_if_visual_shapes_are_missing() -> None:
    model, shapes = model_with_shapes("xarm7")
    sms = ffsms.mount(model, collision=shapes["collision"])
    assert visual_shapes(sms).ngeoms == shapes["collision"].ngeoms + 1  # the satellite's box
    sms = ffsms.mount(model, visual=shapes["visual"])
    assert [item.name for item in sms.geometry("collision").geometryObjects] == ["satellite_0"]


def test_shapes_of_an_mjcf_file_are_loaded(tmp_path: Path) -> None:
    (tmp_path / "two.xml").write_text(MJCF)
    sms = ffsms.mount(tmp_path / "two.xml", placement=PLACE)
    carriers = {item.name: item.parentJoint for item in sms.geometry("collision").geometryObjects}
    assert carriers == {"satellite_0": 1, "foot_0": 1, "upper_0": 2, "lower_0": 3}
    q = sms.configuration([0.3, -0.5])
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, q)
    tool = data.oMf[sms.model.getFrameId("tool")]
    # The last box ends at the tool.
    middle = tool.act(np.array([0.0, 0.0, -0.2]))
    lower = sms.geometry("collision").geometryObjects[-1]
    assert lower.name == "lower_0"
    np.testing.assert_allclose(data.oMi[3].act(lower.placement.translation), middle, atol=1e-12)


def test_only_missing_meshes_of_an_mjcf_file_are_left_out(tmp_path: Path) -> None:
    mesh = '<asset><mesh name="m" file="nowhere.stl"/></asset><worldbody>'
    text = MJCF.replace("<worldbody>", mesh).replace(
        'type="capsule" size="0.05 0.15"', 'type="mesh" mesh="m"'
    )
    (tmp_path / "two.xml").write_text(text)
    with pytest.warns(FfsmsWarning, match=r"missing.*'nowhere\.stl'"):
        sms = ffsms.mount(tmp_path / "two.xml")
    names = [item.name for item in sms.geometry("collision").geometryObjects]
    assert names == ["satellite_0", "foot_0", "lower_0"]


@pytest.mark.parametrize("locked", [{}, {"shoulder_yaw": 0.4}])
def test_a_model_of_a_whole_robot_equals_its_urdf(locked: dict[str, float]) -> None:
    path = model_path("space_arm_7")
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    shapes = {k: pin.buildGeomFromUrdf(model, str(path), kind) for k, kind in KINDS.items()}
    before = list(model.upperVelocityLimit)
    from_urdf = ffsms.load("space_arm_7", locked=locked, velocity=0.2)
    from_model = ffsms.load(
        model,
        "end_effector",
        from_urdf.base_size,
        locked=locked,
        velocity=0.2,
        visual=shapes["visual"],
        collision=shapes["collision"],
    )
    assert from_model.joint_names == from_urdf.joint_names
    assert list(model.upperVelocityLimit) == before  # the user's own model stays as it is
    q = from_urdf.configuration(np.linspace(-0.4, 0.7, from_urdf.n))
    v = np.linspace(-0.2, 0.3, 6 + from_urdf.n)
    for name in ("H", "C_m", "J_star"):
        np.testing.assert_allclose(
            getattr(from_model.at(q, v), name), getattr(from_urdf.at(q, v), name), atol=1e-12
        )
    for kind in KINDS:
        np.testing.assert_allclose(placed(from_model, kind, q), placed(from_urdf, kind, q), atol=1e-9)
    assert from_model.limits.velocity.tolist() == from_urdf.limits.velocity.tolist()


def test_options_for_files_are_refused_for_models(refused: Refused) -> None:
    model = ffsms.load("planar_3r").model
    assert ffsms.load(model).end_effector == ffsms.load("planar_3r").end_effector
    refused(lambda: ffsms.load(model, wheels=["joint1"]), InvalidValue, "wheels", "only with a URDF")
    refused(lambda: ffsms.load(model, srdf="a.srdf"), InvalidValue, "srdf", "only with a URDF")
    refused(lambda: ffsms.load(model, locked={"root_joint": 0.0}), InvalidValue, "root_joint")
    fixed = pin.buildModelFromUrdf(str(model_path("planar_3r")))
    refused(lambda: ffsms.load(fixed), UnsupportedJoint, "free-flyer")
    shapes = pin.GeometryModel()
    refused(lambda: ffsms.load("planar_3r", visual=shapes), InvalidValue, "visual", "its own shapes")


def test_shapes_that_do_not_fit_the_model_are_refused(refused: Refused) -> None:
    model, shapes = model_with_shapes("xarm7")
    refused(lambda: ffsms.mount("xarm7", visual=shapes["visual"]), InvalidValue, "visual", "its own shapes")
    refused(lambda: ffsms.mount(model, collision="boxes"), InvalidValue, "collision", "GeometryModel")
    small = pin.Model()
    small.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "one")
    refused(lambda: ffsms.mount(small, **shapes), InvalidValue, "visual", "last joint is 1")
