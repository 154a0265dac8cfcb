"""Repeat a catch of the packaged `nozzle` in MuJoCo, with the same motion of the joints.

MuJoCo simulates the motion from the hold point on, with its own dynamics. It computes the contact of rod and
nozzle with the same stiffness and friction (see tests/capture/test_contact_beside_mujoco.py). The grip has
the load of `GripLoad`, and the joints have the friction of the scenario. The latch is a plastic impact, after
which MuJoCo simulates the joined bodies. The joints have the recorded torques, and feedback with the gains of
the law towards the recorded motion. Torques alone do not determine the motion of joints with nearly parallel
axes for half a minute. Base, client and contact are not constrained.
"""

from __future__ import annotations

from typing import Any

import mujoco as mj
import numpy as np
import pinocchio as pin

from ffsms_pin import scenarios, simulation
from ffsms_pin.capture import Grip
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import after_capture
from ffsms_pin.client.client import other_motion
from ffsms_pin.export import to_mjcf
from ffsms_pin.options.tables import radians
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.problems import meeting, rendezvous

PARTS, IMPEDANCE = 16, 1e-3  # steps per control step; MuJoCo's regularisation, see the test


class Peer:
    """A robot in MuJoCo, with a client if there is one; q and v are Pinocchio's."""

    def __init__(self, sms: SpaceManipulator, dt: float, outcome: scenarios.Outcome | None = None) -> None:
        self.sms, self.client = sms, None
        spec = mj.MjSpec.from_string(to_mjcf(sms, dt, shapes=False))
        for joint in spec.joints:
            joint.limited = False
        self.load = None
        if outcome is not None:
            encounter = rendezvous(outcome.scenario, sms)
            self.client, scene = encounter.client, encounter.scene
            assert scene is not None
            self.load = scene.load
            self._add(spec)
        self.model = spec.compile()
        self.data = mj.MjData(self.model)
        self.site = self.model.site("end_effector").id
        if self.client is not None:
            self._set_contact()

    def _add(self, spec: Any) -> None:
        """Add the client's body, the rod and the nozzle, and their contact pairs."""
        load, client = self.load, self.client
        assert load is not None
        assert client is not None
        spec.option.disableflags = int(mj.mjtDisableBit.mjDSBL_MULTICCD)  # one contact point per pair
        spec.option.cone, spec.option.impratio = mj.mjtCone.mjCONE_ELLIPTIC, 1000.0
        spec.option.tolerance, spec.option.ccd_tolerance = 1e-14, 1e-12
        body = spec.worldbody.add_body(name="client")
        body.add_freejoint(name="client")
        body.mass, body.explicitinertial = client.mass, True
        body.inertia, body.ipos = np.diag(client.inertia), np.zeros(3)
        site = spec.site("end_effector")
        tool = site.parent
        held = pin.SE3(pin.Quaternion(*site.quat).toRotationMatrix(), np.array(site.pos))
        for k, (shape, place) in enumerate(load.tool_shapes):
            _geom(spec, tool, f"tool_{k}", shape, held * place)
        for k, (shape, place) in enumerate(load.client_shapes):
            _geom(spec, body, f"client_{k}", shape, place)
            for i in range(len(load.tool_shapes)):
                pair = spec.add_pair(geomname1=f"tool_{i}", geomname2=f"client_{k}", condim=3)
                pair.friction = [load.friction, load.friction, 0.0, 0.0, 0.0]
                pair.solimp = [IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0]

    def _set_contact(self) -> None:
        """Set stiffness and friction, times the sum of MuJoCo's inverse masses."""
        model, load = self.model, self.load
        assert load is not None
        tool = model.site_bodyid[self.site]
        weight = model.body_invweight0[tool, 0] + model.body_invweight0[model.body("client").id, 0]
        spring = load.stiffness * weight
        slope = 0.01 * spring / np.sqrt(weight * load.stiffness) / max(load.friction, 0.1)
        model.pair_solref[:] = [-spring, -1e-9 * spring]
        model.pair_solreffriction[:] = [-1e-9, -slope]

    def set(self, q: FloatArray, v: FloatArray, pose: Any = None, twist: FloatArray | None = None) -> None:
        """Set q and v of the robot, and pose and twist of the client."""
        R, n = pin.XYZQUATToSE3(q[:7]).rotation, self.sms.nq
        self.data.qpos[:n] = np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]])
        self.data.qvel[: self.sms.nv] = np.concatenate([R @ v[:3], v[3:]])
        if pose is not None and twist is not None:
            x, y, z, w = pin.SE3ToXYZQUAT(pose)[3:]
            self.data.qpos[n:] = [*pose.translation, w, x, y, z]
            self.data.qvel[self.sms.nv :] = [*twist[:3], *(pose.rotation.T @ twist[3:])]

    def state(self) -> tuple[FloatArray, FloatArray]:
        """Return Pinocchio's q and v of the robot."""
        p, u = self.data.qpos[: self.sms.nq], self.data.qvel[: self.sms.nv]
        q = np.concatenate([p[:3], p[[4, 5, 6, 3]], p[7:]])
        return q, np.concatenate([pin.XYZQUATToSE3(q[:7]).rotation.T @ u[:3], u[3:]])

    def client_state(self) -> tuple[Any, FloatArray]:
        """Return pose and twist of the client."""
        p, u = self.data.qpos[self.sms.nq :], self.data.qvel[self.sms.nv :]
        pose = pin.XYZQUATToSE3(np.concatenate([p[:3], p[[4, 5, 6, 3]]]))
        return pose, np.concatenate([u[:3], pose.rotation @ u[3:]])

    def step(self, tau: FloatArray, friction: Any, grip: GripLoad | None, parts: int) -> None:
        """Simulate a control step under joint torques (n,)."""
        model, data, nv = self.model, self.data, self.sms.nv
        J = np.zeros((6, model.nv))
        for _ in range(parts):
            # MuJoCo's damping is constant; that of `SurfaceContact` grows with depth.
            if data.ncon and self.load is not None:
                deepest = max(0.0, -float(data.contact.dist.min()))
                slower = 1e-9 + 1.5 * self.load.damping * deepest  # in MuJoCo zero selects another format
                model.pair_solref[:, 1] = slower * model.pair_solref[:, 0]
            data.qfrc_applied[:] = 0.0
            data.qfrc_applied[6:nv] = tau + friction(data.qvel[6:nv])
            if grip is not None:
                mj.mj_forward(model, data)
                pose, twist = self.client_state()
                tool = pin.SE3(data.site_xmat[self.site].reshape(3, 3), data.site_xpos[self.site])
                mj.mj_jacSite(model, data, J[:3], J[3:], self.site)
                wrench, point = grip.wrench(tool, J @ data.qvel, pose, twist)
                for body, sign in ((model.site_bodyid[self.site], 1.0), (model.body("client").id, -1.0)):
                    mj.mj_applyFT(
                        model, data, sign * wrench[:3], sign * wrench[3:], point, body, data.qfrc_applied
                    )
            mj.mj_step(model, data)


def _geom(spec: Any, body: Any, name: str, shape: Any, place: Any) -> None:
    x, y, z, w = pin.SE3ToXYZQUAT(place)[3:]
    given: dict[str, Any] = {"name": name, "pos": place.translation, "quat": [w, x, y, z]}
    given |= {"contype": 0, "conaffinity": 0, "mass": 0.0}
    if hasattr(shape, "points"):
        spec.add_mesh(name=name, uservert=np.ravel(shape.points()))
        body.add_geom(type=mj.mjtGeom.mjGEOM_MESH, meshname=name, **given)
    else:
        kind = mj.mjtGeom.mjGEOM_CAPSULE if type(shape).__name__ == "Capsule" else mj.mjtGeom.mjGEOM_CYLINDER
        body.add_geom(type=kind, size=[shape.radius, shape.halfLength, 0.0], **given)


def rates_off(outcome: scenarios.Outcome) -> float:
    """Return the difference of base and joint rates at the end, as a share of the largest rate."""
    found, scenario, plant = outcome.capture, outcome.scenario, outcome.plant
    assert found is not None
    whole, dt = found.whole, float(found.whole.t[1])
    times = {one.name: one.time for one in found.phases}
    first, closed, latched = (round(times[name] / dt) for name in ("closing", "contact", "braking"))
    rub = simulation.JointFriction(**radians(scenario.friction)).torque(plant.n)
    grip = scenario.made(Grip, "contact").load(meeting(scenario.meet or {}, found.client).grasp)
    law: Any = outcome.controller

    def held_to(peer: Peer, k: int) -> FloatArray:
        q, v = peer.state()
        off = pin.difference(plant.model, whole.q[k], q)[6:], v[6:] - whole.v[k, 6:]
        return np.asarray(-peer.sms.at(q).H_q @ (law.K_p @ off[0] + law.K_d @ off[1]))

    peer = Peer(plant, dt / PARTS, outcome)
    held = pin.XYZQUATToSE3(whole.client_pose[first]), whole.client_twist[first]
    peer.set(whole.q[first], whole.v[first], *held)
    for k in range(first, latched):
        peer.step(whole.tau[k] + held_to(peer, k), rub, grip if k >= closed else None, PARTS)
    pose, twist = peer.client_state()
    joined = after_capture(plant, *peer.state(), other_motion(found.client, pose, twist))
    one = Peer(joined.robot, dt / PARTS)
    one.set(joined.q, joined.v)
    for k in range(latched, len(whole.tau)):
        one.step(whole.tau[k] + held_to(one, k), rub, None, PARTS)
    _, v = one.state()
    return float(np.abs(v[3:] - whole.v[-1, 3:]).max() / np.abs(whole.v[-1, 3:]).max())
