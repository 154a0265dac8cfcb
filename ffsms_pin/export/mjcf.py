"""The free-floating system as a MuJoCo model (MJCF)."""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import positive
from ffsms_pin.export.links import NO_LIMIT, Links, joint_axes, triangles
from ffsms_pin.geometry.shapes import ShapeKind
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.urdf_elements import INERTIA_KEYS, spelt

# Two geoms collide if the contype of one and the conaffinity of the other have a common bit. The default of
# both is 1, so collision shapes collide with other bodies of a world, but not with each other.
_KINDS: dict[ShapeKind, dict[str, str]] = {
    "visual": {"group": "2", "contype": "0", "conaffinity": "0"},
    "collision": {"group": "3", "contype": "0", "conaffinity": "1"},
}


def to_mjcf(
    sms: SpaceManipulator, timestep: float = 1e-3, actuators: bool = True, shapes: bool = True
) -> str:
    """Return the robot as MJCF text, with a free base, without gravity, and with the integrator RK4.

    Joints and bodies keep their names. Joints have position limits, armature, damping and friction. Motors
    have torque limits; MuJoCo has no rate limits. The end effector is the site `end_effector`.

    Parameters
    ----------
    sms : SpaceManipulator
    timestep : float
        Time step of the model [s].
    actuators : bool
        True to add a motor to each joint; the motor's control is the joint's torque [N m] or force [N].
    shapes : bool
        True to write the shapes: visual shapes in group 2, and collision shapes in group 3, which MuJoCo's
        viewer hides at first. The text contains the triangles of meshes and needs no other file. The robot's
        shapes do not collide with each other and have no mass.

    Raises
    ------
    GeometryError
        A collision mesh is missing, or a shape has no counterpart in MuJoCo.

    Notes
    -----
    MuJoCo's `qpos` begins with the base's position and quaternion (w, x, y, z). MuJoCo's `qvel` begins with
    the base's linear velocity in inertial axes, then its angular velocity in the base's axes.
    """
    positive("timestep", timestep, "s")
    model, links, axes = sms.model, Links(sms, ["world"]), joint_axes(sms)
    root = Element("mujoco", {"model": model.name})
    SubElement(root, "compiler", {"angle": "radian", "autolimits": "false", "inertiafromgeom": "false"})
    SubElement(root, "option", {"gravity": "0 0 0", "timestep": repr(timestep), "integrator": "RK4"})
    assets, world = SubElement(root, "asset"), SubElement(root, "worldbody")
    bodies: list[Element] = []
    for link in links:
        if link.parent is None:
            body = SubElement(world, "body", {"name": link.name})
            SubElement(body, "freejoint", {"name": link.joint_name})
        elif link.moves:  # child of the parent joint's body, to keep the order of the joints
            on = bodies[links.moving[int(model.parents[link.joint])]]
            body = SubElement(on, "body", {"name": link.name, **_place(model.jointPlacements[link.joint])})
            _joint(body, sms, link.joint - 2, axes[link.joint - 2])
        else:
            place = _place(link.origin(model, links))
            body = SubElement(bodies[link.parent], "body", {"name": link.name, **place})
        if link.moves:
            _inertial(body, model.inertias[link.joint])
        bodies.append(body)
    frame = model.frames[sms.frame_id]
    at = links.carrier(sms.frame_id, sms.tip_joint)
    SubElement(
        bodies[at], "site", {"name": "end_effector", **_place(links[at].place.actInv(frame.placement))}
    )
    meshes: dict[Any, str] = {}
    for kind, flags in _KINDS.items() if shapes else ():
        for at, place, item in links.shapes(sms, kind):
            shape, rgba = _shape(item, assets, meshes), {"rgba": spelt(item.meshColor)}
            SubElement(bodies[at], "geom", {**flags, **shape, **_place(place), **rgba})
    motors = SubElement(root, "actuator")
    for name, torque in zip(sms.joint_names, sms.limits.torque, strict=True) if actuators else ():
        limited = np.isfinite(torque)
        bound = {"ctrllimited": "true", "ctrlrange": spelt([-torque, torque])} if limited else {}
        SubElement(motors, "motor", {"name": name, "joint": name, **bound})
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _joint(body: Element, sms: SpaceManipulator, i: int, axis: Any) -> None:
    bounds = np.array([sms.limits.lower[i], sms.limits.upper[i]])
    limited = {"limited": "false"}
    if np.isfinite(bounds).any():
        limited = {"limited": "true", "range": spelt(np.clip(bounds, -NO_LIMIT, NO_LIMIT))}
    kind = "hinge" if sms.layout.turns[i] else "slide"
    attributes = {"name": sms.joint_names[i], "type": kind, "axis": spelt(axis)}
    losses = {
        "damping": spelt(sms.joint_damping[i]),
        "frictionloss": spelt(sms.joint_friction[i]),
    }
    SubElement(
        body,
        "joint",
        {**attributes, **limited, "armature": spelt(sms.model.armature[6 + i]), **losses},
    )


def _inertial(body: Element, inertia: Any) -> None:
    entries = {key: inertia.inertia[ij] for key, ij in INERTIA_KEYS.items()}
    full = spelt([entries[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")])
    attributes = {"pos": spelt(inertia.lever), "mass": spelt(inertia.mass), "fullinertia": full}
    SubElement(body, "inertial", attributes)


def _place(pose: Any) -> dict[str, str]:
    x, y, z, w = pin.SE3ToXYZQUAT(pose)[3:]
    return {"pos": spelt(pose.translation), "quat": spelt([w, x, y, z])}


def _shape(item: Any, assets: Element, meshes: dict[Any, str]) -> dict[str, str]:
    """Return type and size of a shape; shapes with the same mesh file and scale share an asset."""
    shape = item.geometry
    if isinstance(shape, coal.Box):
        return {"type": "box", "size": spelt(shape.halfSide)}
    if isinstance(shape, coal.Sphere):
        return {"type": "sphere", "size": spelt(shape.radius)}
    if isinstance(shape, coal.Ellipsoid):
        return {"type": "ellipsoid", "size": spelt(shape.radii)}
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        kind = "capsule" if isinstance(shape, coal.Capsule) else "cylinder"
        return {"type": kind, "size": spelt([shape.radius, shape.halfLength])}
    known = (item.meshPath, *item.meshScale) if isinstance(shape, coal.BVHModelBase) else id(item)
    if known not in meshes:
        corners, faces = triangles(item)
        meshes[known] = name = f"mesh_{len(meshes)}"
        vertex = " ".join(map(str, corners.astype(np.float32).ravel()))  # float32, as in mesh files
        face = " ".join(map(str, faces.ravel()))
        # A shell, because an open mesh has no volume, which MuJoCo rejects.
        SubElement(assets, "mesh", {"name": name, "inertia": "shell", "vertex": vertex, "face": face})
    return {"type": "mesh", "mesh": meshes[known]}
