"""The free-floating system as a URDF with its meshes beside it, and as a MuJoCo model, number by number."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import instance, positive
from ffsms_pin.errors import FfsmsWarning, ResultError
from ffsms_pin.files import LARGEST_DATA, path_like, read_content, write_content
from ffsms_pin.interchange.links import NO_LIMIT, Links, joint_axes, triangles
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.shapes import ShapeKind
from ffsms_pin.system.urdf_elements import INERTIA_KEYS, add_inertial, add_origin, words

# What is drawn touches nothing. What collides meets bodies that are put into the world, whose `contype` is 1
# by MuJoCo's default, but no other shape of the robot: 0 & 1 = 0 both ways.
_KINDS: dict[ShapeKind, dict[str, str]] = {
    "visual": {"group": "2", "contype": "0", "conaffinity": "0"},
    "collision": {"group": "3", "contype": "0", "conaffinity": "1"},
}


def to_mjcf(
    sms: SpaceManipulator, timestep: float = 1e-3, actuators: bool = True, shapes: bool = True
) -> str:
    """MJCF text: a free base, the arm's joints and bodies by their names, no gravity, Runge-Kutta.

    Joints stop at their position limits, motors at their torque limits; MuJoCo has no limits of rates. The
    end effector is the site `end_effector`.

    Parameters
    ----------
    sms : SpaceManipulator
    timestep : float
        [s]
    actuators : bool
        Whether each joint gets a motor, whose control is its torque [N m].
    shapes : bool
        Whether shapes are written: what is drawn in group 2, what collides in group 3, which MuJoCo's viewer
        hides at first. Meshes are in the text, triangle by triangle: MuJoCo reads no COLLADA, and the text
        needs no file beside it. Shapes of the robot do not collide with one another. They have no mass.

    Raises
    ------
    GeometryError
        A mesh for collisions is not there, or a shape is none that MuJoCo has.

    Notes
    -----
    MuJoCo's `qpos` begins with the base's position and its quaternion (w, x, y, z); the linear part of its
    `qvel` has inertial axes, the angular part the base's own.
    """
    instance("sms", sms, SpaceManipulator)
    positive("timestep", timestep, "s")
    for name, value in (("actuators", actuators), ("shapes", shapes)):
        instance(name, value, bool)
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
        elif link.moves:  # straight on the body that moves it: between others MuJoCo would order joints anew
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
    at = links.carrier(sms.frame_id, int(frame.parentJoint))
    SubElement(
        bodies[at], "site", {"name": "end_effector", **_place(links[at].place.actInv(frame.placement))}
    )
    meshes: dict[Any, str] = {}
    for kind, flags in _KINDS.items() if shapes else ():
        for at, place, item in links.shapes(sms, kind):
            shape, rgba = _shape(item, assets, meshes), {"rgba": words(item.meshColor)}
            SubElement(bodies[at], "geom", {**flags, **shape, **_place(place), **rgba})
    motors = SubElement(root, "actuator")
    for name, torque in zip(sms.joint_names, sms.limits.torque, strict=True) if actuators else ():
        limited = np.isfinite(torque)
        bound = {"ctrllimited": "true", "ctrlrange": words([-torque, torque])} if limited else {}
        SubElement(motors, "motor", {"name": name, "joint": name, **bound})
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _joint(body: Element, sms: SpaceManipulator, i: int, axis: Any) -> None:
    bounds = np.array([sms.limits.lower[i], sms.limits.upper[i]])
    limited = {"limited": "false"}
    if np.isfinite(bounds).any():
        limited = {"limited": "true", "range": words(np.clip(bounds, -NO_LIMIT, NO_LIMIT))}
    kind = "hinge" if sms.layout.turns[i] else "slide"
    given = {"name": sms.joint_names[i], "type": kind, "axis": words(axis)}
    SubElement(body, "joint", {**given, **limited, "armature": words(sms.model.armature[6 + i])})


def _inertial(body: Element, inertia: Any) -> None:
    entries = {key: inertia.inertia[ij] for key, ij in INERTIA_KEYS.items()}
    full = words([entries[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")])
    given = {"pos": words(inertia.lever), "mass": words(inertia.mass), "fullinertia": full}
    SubElement(body, "inertial", given)


def _place(pose: Any) -> dict[str, str]:
    x, y, z, w = pin.SE3ToXYZQUAT(pose)[3:]
    return {"pos": words(pose.translation), "quat": words([w, x, y, z])}


def _shape(item: Any, assets: Element, meshes: dict[Any, str]) -> dict[str, str]:
    """Type and size of a shape; that of a mesh is an asset, which shapes of one file share."""
    shape = item.geometry
    if isinstance(shape, coal.Box):
        return {"type": "box", "size": words(shape.halfSide)}
    if isinstance(shape, coal.Sphere):
        return {"type": "sphere", "size": words(shape.radius)}
    if isinstance(shape, coal.Ellipsoid):
        return {"type": "ellipsoid", "size": words(shape.radii)}
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        kind = "capsule" if isinstance(shape, coal.Capsule) else "cylinder"
        return {"type": kind, "size": words([shape.radius, shape.halfLength])}
    known = (item.meshPath, *item.meshScale) if isinstance(shape, coal.BVHModelBase) else id(item)
    if known not in meshes:
        corners, faces = triangles(item)
        meshes[known] = name = f"mesh_{len(meshes)}"
        vertex = " ".join(map(str, corners.astype(np.float32).ravel()))  # as mesh files are read, too
        face = " ".join(map(str, faces.ravel()))
        # As a shell: volumes of meshes that are not closed make no sense, and none is needed.
        SubElement(assets, "mesh", {"name": name, "inertia": "shell", "vertex": vertex, "face": face})
    return {"type": "mesh", "mesh": meshes[known]}


def to_urdf(sms: SpaceManipulator, path: str | os.PathLike[str]) -> None:
    """Write the robot as a URDF; its root link is the satellite, whatever the robot was made from.

    Links, joints and end effector keep their names, shapes their places and colours. The inertia of what is
    fixed to a link is in that link. Limits are those of `sms.limits`; without one, 1e13. Meshes are copied
    into a folder beside the file, NAME_meshes, so that both can be taken to a machine without their packages;
    textures are not. An SRDF is copied, too.

    A URDF holds no acceleration limits, wheels, thrusters, and no other base box than the first box of the
    base link; give them to `load` again. Its readers may order the joints of a fork by their names.

    Parameters
    ----------
    sms : SpaceManipulator
    path : path
        Of the file; its folder is there.

    Raises
    ------
    GeometryError
        A mesh for collisions is not there, or a shape is none that a file can hold.
    ResultError
        A file cannot be written.

    Warns
    -----
    FfsmsWarning
        A joint has a rotor's inertia (`armature`), which a URDF cannot say; a visual mesh is not there.
    """
    instance("sms", sms, SpaceManipulator)
    path = path_like("path", path)
    model = sms.model
    if np.any(model.armature):
        text = "a URDF holds no rotor inertia (armature): the joints of the file are lighter"
        warnings.warn(text, FfsmsWarning, stacklevel=2)
    robot, links = Element("robot", {"name": model.name or "robot"}), Links(sms)
    elements = [SubElement(robot, "link", {"name": link.name}) for link in links]
    for link, element in zip(links, elements, strict=True):
        if link.moves:
            body = model.inertias[link.joint]
            add_inertial(element, body.mass, body.lever, body.inertia)
    meshes = _Meshes(path)
    kinds: tuple[ShapeKind, ...] = ("visual", "collision")
    for kind in kinds:
        for at, place, item in links.shapes(sms, kind):
            for pose, tag, given in _geometries(item, meshes):
                shape = SubElement(elements[at], kind)
                add_origin(shape, place * pose)
                SubElement(SubElement(shape, "geometry"), tag, given)
                if kind == "visual" and (item.overrideMaterial or tag != "mesh"):
                    colour = words(item.meshColor)
                    SubElement(SubElement(shape, "material", {"name": colour}), "color", {"rgba": colour})
    axes = joint_axes(sms)
    for link in links:
        if link.parent is None:
            continue
        joint = SubElement(robot, "joint", {"name": link.joint_name, "type": "fixed"})
        SubElement(joint, "parent", {"link": links[link.parent].name})
        SubElement(joint, "child", {"link": link.name})
        add_origin(joint, link.origin(model, links))
        if link.moves:
            i = link.joint - 2
            turning = "continuous" if sms.layout.continuous[i] else "revolute"
            joint.set("type", turning if sms.layout.turns[i] else "prismatic")
            SubElement(joint, "axis", {"xyz": words(axes[i])})
            _limit(joint, sms, i)
    indent(robot)
    meshes.write()
    write_content(path, tostring(robot, encoding="unicode") + "\n")
    if sms.description is not None and sms.description.srdf is not None:
        write_content(path.with_suffix(".srdf"), read_content(sms.description.srdf))


class _Meshes:
    """The folder of meshes beside a file."""

    def __init__(self, path: Path) -> None:
        self._folder = path.parent / f"{path.stem}_meshes"
        self._files: dict[str, Path | bytes] = {}

    def add(self, item: Any) -> str:
        """The name by which the file refers to the mesh of a shape: a copy of it, or an OBJ made of it."""
        source = Path(item.meshPath)
        content: Path | bytes = source
        if not os.path.isfile(source):
            corners, faces = triangles(item)
            lines = [f"v {words(corner)}" for corner in corners]
            lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
            source, content = Path(f"{item.name}.obj"), ("\n".join(lines) + "\n").encode()
        name, k = source.name, 1
        while self._files.setdefault(name, content) != content:
            name, k = f"{source.stem}_{k}{source.suffix}", k + 1
        return f"{self._folder.name}/{name}"

    def write(self) -> None:
        """Write all of them."""
        for name, content in self._files.items():
            try:
                self._folder.mkdir(exist_ok=True)
                raw = content if isinstance(content, bytes) else read_content(content, LARGEST_DATA)
            except OSError as error:
                raise ResultError(self._folder, f"cannot be written: {name} ({error.strerror})") from None
            write_content(self._folder / name, raw)


def _geometries(item: Any, meshes: _Meshes) -> list[tuple[Any, str, dict[str, str]]]:
    """Pose in the shape's own axes, tag and attributes of what a shape becomes: a capsule is three."""
    shape, here = item.geometry, pin.SE3.Identity()
    if isinstance(shape, coal.Box):
        return [(here, "box", {"size": words(2.0 * shape.halfSide)})]
    if isinstance(shape, coal.Sphere):
        return [(here, "sphere", {"radius": words(shape.radius)})]
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        radius, half = words(shape.radius), float(shape.halfLength)
        found = [(here, "cylinder", {"radius": radius, "length": words(2.0 * half)})]
        if isinstance(shape, coal.Capsule):
            ends = [pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in (-half, half)]
            found += [(end, "sphere", {"radius": radius}) for end in ends]
        return found
    scale = words(item.meshScale if os.path.isfile(item.meshPath) else np.ones(3))
    return [(here, "mesh", {"filename": meshes.add(item), "scale": scale})]


def _limit(joint: Element, sms: SpaceManipulator, i: int) -> None:
    names = {"lower": "lower", "upper": "upper", "velocity": "velocity", "effort": "torque"}
    if sms.layout.continuous[i]:
        del names["lower"], names["upper"]
    bounds = {
        key: words(np.clip(getattr(sms.limits, name)[i], -NO_LIMIT, NO_LIMIT)) for key, name in names.items()
    }
    SubElement(joint, "limit", bounds)
    model = sms.model
    friction = {"damping": model.damping[6 + i], "friction": model.upperDryFrictionLimit[6 + i]}
    if any(friction.values()):
        SubElement(joint, "dynamics", {key: words(value) for key, value in friction.items()})
