"""The reader of MJCF files, which MuJoCo compiles; the robot is made from the compiled model."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path, PurePath
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsWarning, InvalidUrdf, UnsupportedJoint, require
from ffsms_pin.files import check_readable
from ffsms_pin.robot.building import given_shapes
from ffsms_pin.system.inertias import Inertias, settle, settled
from ffsms_pin.system.urdf_elements import unused

_FREE, _BALL, _SLIDE, _HINGE = range(4)  # types of joints in MuJoCo (mjtJoint)
_PLANE, _HEIGHTS, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = range(8)  # types of geoms (mjtGeom)
_JOINT, _JOINT_IN_PARENT, _TENDON = 0, 1, 3  # transmissions of actuators (mjtTrn)
_FIRST_HIDDEN = 3  # shapes of this and higher groups are not drawn, as by default in MuJoCo's viewer
_FROM_GEOM, _AUTO = 1, 2  # values of `inertiafromgeom`


def read_mjcf(
    path: Path, whole: bool, inertias: Inertias, stacklevel: int
) -> tuple[Any, tuple[Any, Any] | None]:
    """Return the robot of an MJCF file as a pinocchio.Model, and its visual and collision shapes.

    Parameters
    ----------
    path : Path
        The MJCF file.
    whole : bool
        True to read the robot on a free joint. False to read the trees of joints without a free joint, which
        are arms; if there are none, the robot on a free joint is read without that joint.
    inertias : {"check", "keep", "repair"}
        See `ffsms_pin.load`.
    stacklevel : int
        The argument of `warnings.warn`: 2 names the line that calls this function.

    Raises
    ------
    DependencyMissing, InvalidUrdf, InvalidInertia, UnsupportedJoint
    """
    require("mjcf", f"reading {path.name}, an MJCF file,")
    source = _Source(path, inertias)
    robot = _Robot(source, whole)
    for sentence in (*source.sentences, *robot.sentences):
        warnings.warn(f"{path}: {sentence}", FfsmsWarning, stacklevel=stacklevel)
    return robot.model, given_shapes(robot.model, robot.visual, robot.collision)


class _Source:
    """An MJCF file and the mujoco.MjModel `compiled` from it.

    `tensors` maps the indices of the bodies whose inertias MuJoCo refuses to the inertias (3, 3) [kg m^2] to
    use, in the axes of MuJoCo's inertial frame. `sentences` are the texts of warnings.
    """

    def __init__(self, path: Path, inertias: Inertias) -> None:
        import mujoco  # imported here because only MJCF files need it

        self.path, self.sentences = path, list[str]()
        try:
            check_readable(path)
            # MuJoCo opens only files that end in .xml, but includes a file with any ending.
            included = f"<mujoco><include file={quoteattr(os.path.abspath(path))}/></mujoco>"
            is_xml = path.suffix.lower() == ".xml"
            spec = mujoco.MjSpec.from_file(str(path)) if is_xml else mujoco.MjSpec.from_string(included)
            self._spec = spec
        except Exception as error:  # MuJoCo's parser has exception types of its own
            raise self._invalid(error) from None
        # Textures and skins are not used, so their files may be missing.
        for item in spec.materials:
            for i in range(len(item.textures)):
                item.textures[i] = ""
        for item in [*spec.skins, *spec.textures]:
            spec.delete(item)
        named = is_xml and spec.modelname != "MuJoCo Model"  # the default name
        self.name = str(spec.modelname) if named else path.stem
        spec.compiler.discardvisual = False
        if spec.compiler.settotalmass > 0.0 and spec.compiler.fusestatic:
            message = (
                "settotalmass with fusestatic applies to moving bodies only, so bodies fixed to the world"
            )
            self.sentences.append(f"{message} have no mass")
        else:
            spec.compiler.fusestatic = False  # fixed bodies keep their names and masses
        inertias_of_bodies = self._settle(inertias)
        self.compiled = self._compile()
        # `settotalmass` scales masses and inertias by the same factor.
        self.tensors = {
            b: tensor * (self.compiled.body_mass[b] / mass if mass > 0.0 else 1.0)
            for b, (mass, tensor) in inertias_of_bodies.items()
        }

    def _invalid(self, error: Exception) -> InvalidUrdf:
        text = " ".join(str(error).split()).removeprefix("Error: ")
        return InvalidUrdf(self.path, f"MuJoCo cannot read it as MJCF ({text})")

    def _settle(self, inertias: Inertias) -> dict[int, tuple[float, FloatArray]]:
        """Replace nonzero inertias that MuJoCo refuses by isotropic inertias, and return those of `settle`.

        The result maps the index of each such body to its mass [kg] and the inertia (3, 3) [kg m^2] to use.
        """
        replaced, changes = dict[int, tuple[float, FloatArray]](), dict[str, str]()
        if self._spec.compiler.inertiafromgeom == _FROM_GEOM or self._spec.compiler.balanceinertia:
            return replaced  # MuJoCo does not use the file's inertias, or corrects them
        for b, body in enumerate(self._spec.bodies):
            full = np.array(body.fullinertia)
            is_full = bool(np.isfinite(full[0]))
            xx, yy, zz, xy, xz, yz = full if is_full else (*body.inertia, 0.0, 0.0, 0.0)
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if not body.explicitinertial or not np.isfinite(tensor).all() or not tensor.any():
                continue
            least, middle, most = np.linalg.eigvalsh(tensor)
            if least > 0.0 and least + middle >= most:
                continue
            name = body.name or f"body {b}"
            better, change = settle(self.path, name, tensor, inertias)
            if change:
                changes[name] = change
            replaced[b] = float(body.mass), better
            body.fullinertia = np.array([np.nan, *np.zeros(5)])
            body.inertia = np.full(3, np.abs(tensor).max())
        if replaced and self._spec.compiler.fusestatic:
            names = ", ".join(f"'{self._spec.bodies[b].name or f'body {b}'}'" for b in replaced)
            message = f"the inertia of {names} is not physical, and MuJoCo would merge it with others"
            raise InvalidUrdf(self.path, f"{message}; set fusestatic='false' in <compiler>")
        if changes:
            self.sentences.append(settled(changes, inertias))
        return replaced

    def _compile(self) -> Any:
        """Return the compiled model (mujoco.MjModel) of the file without its missing meshes."""
        missing = list[str]()
        while True:
            try:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    compiled = self._spec.compile()
                self.sentences.extend(
                    f"MuJoCo warns: {' '.join(str(item.message).split())}" for item in caught
                )
                break
            except Exception as error:  # MuJoCo's compiler has exception types of its own
                names = {PurePath(name).name for name in re.findall(r"'([^']+)'", str(error))}
                gone = [mesh for mesh in self._spec.meshes if mesh.file and PurePath(mesh.file).name in names]
                if "opening" not in str(error) or not gone:
                    raise self._invalid(error) from None
            for mesh in gone:
                missing.append(f"'{mesh.file}'")
                self._leave_out(mesh)
        if missing:
            message = "missing meshes are left out of the visual and the collision shapes:"
            self.sentences.append(f"{message} {', '.join(missing)}")
        return compiled

    def _leave_out(self, mesh: Any) -> None:
        """Delete a mesh and its geoms; raise `InvalidUrdf` if the mass of a body depends on these geoms."""
        compiler = self._spec.compiler
        low, high = compiler.inertiagrouprange
        for geom in [geom for geom in self._spec.geoms if geom.meshname == mesh.name]:
            body = geom.parent
            ignored = compiler.inertiafromgeom == _FROM_GEOM  # the <inertial> of a body
            from_geoms = ignored or (compiler.inertiafromgeom == _AUTO and not body.explicitinertial)
            massless = geom.mass == 0.0 or (np.isnan(geom.mass) and geom.density == 0.0)
            if from_geoms and not massless and low <= geom.group <= high and body.name != "world":
                message = (
                    f"the mesh '{mesh.file}' is missing, and the mass of body '{body.name}' depends on it"
                )
                remedy = "add the file, or an <inertial> to the body"
                if ignored:
                    remedy += " and inertiafromgeom='auto' to <compiler>"
                raise InvalidUrdf(self.path, f"{message}; {remedy}")
            self._spec.delete(geom)
        self._spec.delete(mesh)


class _Place(NamedTuple):
    """The indices of a body's joint and frame in the model, and the body's pose in the joint's frame."""

    joint: int
    frame: int
    pose: Any


class _Robot:
    """The pinocchio.Model and shapes of a compiled MJCF file; `sentences` are the texts of warnings."""

    def __init__(self, source: _Source, whole: bool) -> None:
        self._path, self._compiled, self._tensors = source.path, source.compiled, source.tensors
        self.sentences = list[str]()
        self.model = pin.Model()
        self.model.name = source.name
        self.visual, self.collision = pin.GeometryModel(), pin.GeometryModel()
        m = self._compiled
        roots = self._roots(whole)
        self._names = {m.body(b).name for b in range(m.nbody)}
        self._joint_names = {m.joint(j).name for j in range(m.njnt)}
        self._places = {0: _Place(0, 0, pin.SE3.Identity())}
        for b in range(1, m.nbody):
            if m.body_rootid[b] in roots:
                self._add_body(b, floating=whole)
        self._add_sites()
        self._add_shapes(whole)
        self._note_unused(roots)

    def _roots(self, whole: bool) -> set[int]:
        """Return the indices of the children of the world that are the roots of the robot's trees."""
        m = self._compiled
        tops = [b for b in range(1, m.nbody) if m.body_parentid[b] == 0]
        kinds: dict[int, set[int]] = {top: set() for top in tops}
        for j in range(m.njnt):
            kinds[int(m.body_rootid[m.jnt_bodyid[j]])].add(int(m.jnt_type[j]))
        free = [top for top in tops if _FREE in kinds[top]]
        robots = [top for top in free if kinds[top] - {_FREE}]
        arms = [top for top in tops if kinds[top] and top not in free]
        if whole and not robots:
            message = (
                "the file has no free joint that carries an arm; ffsms_pin.mount puts an arm on a satellite"
            )
            raise UnsupportedJoint(self._path, message)
        if not whole and not arms and robots:
            names = ", ".join(f"'{m.body(top).name}'" for top in robots)
            message = f"the free joint of {names} is left out, because the arm's first body is fixed to the"
            self.sentences.append(f"{message} satellite; ffsms_pin.load reads the whole robot")
        chosen = robots if whole or not arms else arms
        if not chosen:
            message = "the file has no joint except free joints; an arm needs at least one"
            raise UnsupportedJoint(self._path, message)
        if len(chosen) > 1 and chosen is robots:
            names = ", ".join(f"'{m.body(top).name}'" for top in robots)
            message = f"the file has several robots with a free joint: {names}; keep one"
            raise UnsupportedJoint(self._path, message)
        return set(chosen)

    def _add_body(self, b: int, floating: bool) -> None:
        m, model = self._compiled, self.model
        parent, carrier, on = self._places[int(m.body_parentid[b])]
        root = m.body_parentid[b] == 0
        here = on * _pose(m.body_pos[b], m.body_quat[b])
        for j in range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b]):
            kind, name = int(m.jnt_type[j]), m.joint(j).name
            if not name:
                name = unused(f"joint_{j}", self._joint_names)
                self._joint_names.add(name)
            if kind == _FREE:
                here = pin.SE3.Identity()
                if floating:
                    parent = model.addJoint(0, pin.JointModelFreeFlyer(), here, name or "root_joint")
                    carrier = model.addJointFrame(parent, 0)
                continue
            if kind == _BALL:
                message = f"joint '{name}' is a ball joint; only joints with one degree of freedom are"
                raise UnsupportedJoint(self._path, f"{message} supported")
            axis, at = np.array(m.jnt_axis[j]), pin.SE3(np.eye(3), np.array(m.jnt_pos[j]))
            parent = model.addJoint(parent, _JOINTS[kind](axis), here * at, name)
            carrier = model.addJointFrame(parent, carrier)
            self._describe(j)
            start = float(m.qpos0[m.jnt_qposadr[j]])  # the joint position in the pose of the file
            turn = pin.AngleAxis(-start, axis).matrix() if kind == _HINGE else np.eye(3)
            slide = np.zeros(3) if kind == _HINGE else -start * axis
            here = pin.SE3(turn, slide) * at.inverse()
        if root and m.body_jntnum[b] and not floating and m.jnt_type[m.body_jntadr[b]] == _FREE:
            here = pin.SE3.Identity()
        name = m.body(b).name or unused(f"body_{b}", self._names)
        self._names.add(name)
        inertial = _pose(m.body_ipos[b], m.body_iquat[b])
        own = self._tensors.get(b, np.diag(m.body_inertia[b]))
        inertia = inertial.act(pin.Inertia(float(m.body_mass[b]), np.zeros(3), own))
        model.appendBodyToJoint(parent, inertia, here)
        frame = model.addFrame(pin.Frame(name, parent, carrier, here, pin.FrameType.BODY), False)
        self._places[b] = _Place(parent, frame, here)

    def _describe(self, j: int) -> None:
        """Set the armature, damping, friction, position and torque limits of the model's last joint.

        The numbers are those of joint j of the file.
        """
        m, model, i = self._compiled, self.model, int(self._compiled.jnt_dofadr[j])
        model.armature[-1] = m.dof_armature[i]
        model.damping[-1] = np.ravel(m.dof_damping[i])[0]
        model.lowerDryFrictionLimit[-1], model.upperDryFrictionLimit[-1] = _symmetric(m.dof_frictionloss[i])
        low, high = m.jnt_range[j] if m.jnt_limited[j] else (-np.inf, np.inf)
        model.lowerPositionLimit[-1], model.upperPositionLimit[-1] = low, high
        low, high = self._torque(j)
        torque = min(-low, high) if low < 0.0 < high else max(-low, high)  # one limit for both signs
        model.lowerEffortLimit[-1], model.upperEffortLimit[-1] = _symmetric(torque)

    def _torque(self, j: int) -> tuple[float, float]:
        """Return the lowest and highest torque of joint j's actuators [N m or N]; infinite without a limit.

        The limits are those of the actuators and of the joint (`actuatorfrcrange`). The armature and damping
        of the actuators are added to those of the model's last joint.
        """
        m, model = self._compiled, self.model
        lows, highs = list[float](), list[float]()
        for a in range(m.nactuator):
            if m.actuator_trntype[a] not in (_JOINT, _JOINT_IN_PARENT) or m.actuator_trnid[a, 0] != j:
                continue
            gear = float(m.actuator_gear[a, 0])
            model.armature[-1] += gear**2 * float(np.ravel(m.actuator_armature[a])[0])
            model.damping[-1] += gear**2 * float(np.ravel(m.actuator_damping[a])[0])
            bounds = np.array([-np.inf, np.inf])
            if m.actuator_forcelimited[a]:
                bounds = m.actuator_forcerange[a] * gear
            c = int(m.actuator_ctrladr[a])
            plain = not m.actuator_gaintype[a] and not m.actuator_biastype[a] and not m.actuator_dyntype[a]
            if plain and m.actuator_ctrlnum[a] == 1 and m.actuator_ctrllimited[c]:  # a motor
                ctrl = np.sort(m.actuator_ctrlrange[c] * m.actuator_gainprm[a, 0] * gear)
                bounds = np.sort(bounds)
                bounds = np.array([max(bounds[0], ctrl[0]), min(bounds[1], ctrl[1])])
            lows.append(float(min(bounds)))
            highs.append(float(max(bounds)))
        low, high = (sum(lows), sum(highs)) if lows else (-np.inf, np.inf)
        if m.jnt_actfrclimited[j]:
            low, high = max(low, float(m.jnt_actfrcrange[j, 0])), min(high, float(m.jnt_actfrcrange[j, 1]))
        if not max(-low, high) > 0.0:
            return -np.inf, np.inf
        return low, high

    def _add_sites(self) -> None:
        m = self._compiled
        for s in range(m.nsite):
            place, name = self._places.get(int(m.site_bodyid[s])), m.site(s).name
            if place is None or place.joint == 0 or not name:
                continue
            pose = place.pose * _pose(m.site_pos[s], m.site_quat[s])
            frame = pin.Frame(name, place.joint, place.frame, pose, pin.FrameType.OP_FRAME)
            self.model.addFrame(frame, False)

    def _add_shapes(self, whole: bool) -> None:
        m, counts, left_out = self._compiled, dict[int, int](), list[str]()
        for g in range(m.ngeom):
            b, kind = int(m.geom_bodyid[g]), int(m.geom_type[g])
            place = self._places.get(b)
            if place is None or (b == 0 and (whole or kind in (_PLANE, _HEIGHTS))):
                if b == 0:  # other bodies outside the robot are listed by `_note_unused`
                    left_out.append(m.geom(g).name or f"number {g}")
                continue
            body = m.body(b).name or "body"
            name = m.geom(g).name or f"{body}_{counts.setdefault(b, 0)}"
            counts[b] = counts.get(b, 0) + 1
            shape = self._shape(g)
            if shape is None:
                left_out.append(name)
                continue
            pose = place.pose * _pose(m.geom_pos[g], m.geom_quat[g])
            collides = bool(m.geom_contype[g] or m.geom_conaffinity[g])
            for included, shapes in (
                (m.geom_group[g] < _FIRST_HIDDEN, self.visual),
                (collides, self.collision),
            ):
                if included:
                    taken = {item.name for item in shapes.geometryObjects}
                    item = pin.GeometryObject(unused(name, taken), place.joint, place.frame, pose, shape)
                    item.overrideMaterial, item.meshColor = True, self._colour(g)
                    shapes.addGeometryObject(item)
        if left_out:
            message = "shapes of the world, planes, height fields and distance fields are left out:"
            self.sentences.append(f"{message} {_listed(left_out)}")

    def _shape(self, g: int) -> Any:
        m, kind = self._compiled, int(self._compiled.geom_type[g])
        x, y, z = m.geom_size[g]
        if kind == _MESH:
            return _mesh(m, int(m.geom_dataid[g]))
        made = {
            _SPHERE: lambda: coal.Sphere(x),
            _CAPSULE: lambda: coal.Capsule(x, 2.0 * y),
            _ELLIPSOID: lambda: coal.Ellipsoid(x, y, z),
            _CYLINDER: lambda: coal.Cylinder(x, 2.0 * y),
            _BOX: lambda: coal.Box(2.0 * x, 2.0 * y, 2.0 * z),
        }
        return made[kind]() if kind in made else None

    def _colour(self, g: int) -> FloatArray:
        m, material = self._compiled, int(self._compiled.geom_matid[g])
        own = np.array(m.geom_rgba[g], dtype=np.float64)
        if material >= 0 and np.allclose(own, [0.5, 0.5, 0.5, 1.0]):  # the default, if the geom has no colour
            return np.array(m.mat_rgba[material], dtype=np.float64)
        return own

    def _note_unused(self, roots: set[int]) -> None:
        """Add a sentence that lists the unsupported elements of the file to `sentences`."""
        m = self._compiled
        inside = [j for j in range(m.njnt) if m.body_rootid[m.jnt_bodyid[j]] in roots]
        springs = [
            m.joint(j).name for j in inside if m.jnt_stiffness[j] != 0.0 or np.any(m.jnt_stiffnesspoly[j])
        ]
        curved = [m.joint(j).name for j in inside if np.any(m.dof_dampingpoly[m.jnt_dofadr[j]])]
        others = [
            m.body(b).name or f"number {b}"
            for b in range(1, m.nbody)
            if m.body_parentid[b] == 0 and b not in roots
        ]
        equalities = [m.equality(e).name or f"number {e}" for e in range(m.neq)]
        tendons = [m.tendon(t).name or f"number {t}" for t in range(m.ntendon)]
        known = (_JOINT, _JOINT_IN_PARENT, _TENDON)
        acting = [m.actuator(a).name or f"number {a}" for a in range(m.nactuator)]
        acting = [name for a, name in enumerate(acting) if m.actuator_trntype[a] not in known]
        parts = {
            "springs of the joints": springs,
            "nonlinear damping of the joints": curved,
            "bodies that are not part of the robot": others,
            "equality constraints": equalities,
            "tendons": tendons,
            "flexible bodies": [f"number {i}" for i in range(m.nflex)],
            "actuators that act on no joint": acting,
        }
        if kinds := [f"{what} ({_listed(names)})" for what, names in parts.items() if names]:
            self.sentences.append(f"elements that are not supported are left out: {'; '.join(kinds)}")


_JOINTS = {_HINGE: pin.JointModelRevoluteUnaligned, _SLIDE: pin.JointModelPrismaticUnaligned}


def _symmetric(bound: float) -> tuple[float, float]:
    """Return -bound and bound; an infinite bound becomes the largest float, as in Pinocchio's models."""
    bound = min(float(bound), float(np.finfo(np.float64).max))
    return -bound, bound


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return ", ".join(f"'{name}'" for name in names[:8]) + more


def _pose(position: Any, quaternion: Any) -> Any:
    """Return the pose (pinocchio.SE3) of a position (3,) and a quaternion (w, x, y, z)."""
    w, x, y, z = (float(part) for part in quaternion)
    turn = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    return pin.SE3(turn, np.array(position, dtype=np.float64))


def _mesh(m: Any, k: int) -> Any:
    """Return mesh k of a compiled model as a coal shape, with vertices in the frame of the geom."""
    first, count = int(m.mesh_vertadr[k]), int(m.mesh_vertnum[k])
    corners = np.array(m.mesh_vert[first : first + count], dtype=np.float64)
    first, count = int(m.mesh_faceadr[k]), int(m.mesh_facenum[k])
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(count, len(corners))
    mesh.addVertices(corners)
    mesh.addTriangles(np.array(m.mesh_face[first : first + count], dtype=np.int64))
    mesh.endModel()
    return mesh
