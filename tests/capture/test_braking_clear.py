"""Braking with a grasped client, and the clearance between its boom and the servicer."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from by_coal import ByCoal

import ffsms_pin as ffsms
from ffsms_pin.capture.braking import Braking, _braking, brake
from ffsms_pin.capture.prediction import predicted
from ffsms_pin.client import AfterCapture, after_capture
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.opt import Obstacle

CLEARANCE = 0.01
LONG = coal.Box(0.06, 0.06, 2.0)
# Joint positions, rotation vector of the boom in the gripper, joint rates: the boom swings towards the
# servicer's box.
BESIDE = (
    [-0.39, -0.25, -0.1, -2.54, 0.59, 2.93, 0.91],
    [-0.45, -0.37, -0.03],
    [0.1, 0.09, -0.05, -0.09, 0.02, -0.05, 0.08],
)
BRISK = (
    [0.01, -0.49, 0.0, -2.5, 0.47, 2.65, 1.15],
    [-1.62, -0.58, -1.02],
    [0.16, 0.13, -0.1, -0.12, 0.03, 0.02, 0.04],
)
HOPELESS = (
    [0.07, -0.59, 0.33, -2.38, 0.26, 2.41, 0.68],
    [0.3, -0.98, -2.09],
    [-0.12, -0.09, -0.04, -0.34, 0.1, 0.0, 0.19],
)


class Scene:
    """A grasped client of 40 kg with a boom of 2 m."""

    def __init__(self, joints: list[float], rotation_vector: list[float], rates: list[float]) -> None:
        self.sms = ffsms.load("satellite_panda")
        self.q = self.sms.configuration(joints)
        v, R = self.sms.velocity(self.q, rates), pin.exp3(np.array(rotation_vector))
        state = self.sms.at(self.q, v)
        self.in_client = pin.SE3(R, R @ [0.0, 0.0, 1.0] + [0.0, 0.0, 0.15])
        self.client = ffsms.Client(40.0, [14.0, 14.0, 1.0], state.end_effector_pose, state.end_effector_twist)
        self.boom = Obstacle(LONG, self.in_client, name="boom")
        self.after: AfterCapture = after_capture(self.sms, self.q, v, self.client)

    def held_client(self, q: np.ndarray, pose: pin.SE3) -> HeldClient:
        return HeldClient(self.sms, [self.boom], CLEARANCE, "auto", q, pose)

    def by_coal(self, braking: Braking) -> float:
        """Return the least distance of the boom to the links before the last joint, by Coal on the meshes."""
        measure, hand = ByCoal(self.sms), self.sms.model.frames[self.sms.frame_id].parentJoint
        # The client's frame coincides with the end effector's frame at the capture.
        return min(
            measure(q, LONG, self.sms.at(q).end_effector_pose * self.in_client, list(range(1, hand)))
            for q in braking.q
        )


@pytest.mark.parametrize(("case", "torques"), [(BESIDE, 0.5), (BRISK, 1.0)])
def test_a_boom_keeps_clear_while_joints_brake(case: tuple[list[float], ...], torques: float) -> None:
    scene = Scene(*case)
    plain, clear = (
        brake(scene.after),
        brake(scene.after, room=scene.held_client(scene.q, scene.client.start_pose)),
    )
    assert scene.by_coal(plain) < 0.5 * CLEARANCE
    assert plain.nearest == ""
    assert CLEARANCE <= clear.clearance <= scene.by_coal(clear) + 1e-6
    assert clear.nearest == "satellite - boom"
    assert clear.torque_share <= torques
    assert ("torque limit" in clear.note) == (torques > 0.5)
    # The joints still brake from their rates at the capture to rest, within their limits.
    np.testing.assert_allclose(clear.joint_rates[0], scene.after.v[6:], atol=1e-12)
    assert not clear.joint_rates[-1].any()
    accelerations = np.diff(clear.joint_rates, axis=0) / np.diff(clear.t)[:, None]
    assert (np.abs(accelerations) <= scene.sms.limits.acceleration).all()


@pytest.mark.parametrize("on", ["inertial", "base"])
def test_a_boom_keeps_clear_of_obstacles(on: str) -> None:
    """Place a ball where the end of the boom would come to rest: in inertial space, or on the base."""
    scene, end = Scene(*BESIDE), pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    plain, ball = (
        brake(scene.after, room=scene.held_client(scene.q, scene.client.start_pose)),
        coal.Sphere(0.05),
    )
    place = scene.sms.at(plain.q[-1]).end_effector_pose * scene.in_client * end
    place.rotation = np.eye(3)
    root = pin.XYZQUATToSE3(scene.q[:7]) if on == "base" else pin.SE3.Identity()
    around = Obstacle(ball, root.inverse() * place, on=on, name="ball")
    arguments = scene.sms, [scene.boom], CLEARANCE, "auto", scene.q, scene.client.start_pose
    clear = brake(scene.after, room=HeldClient(*arguments, [around]))
    distances = []
    for braking in (plain, clear):
        least = np.inf
        for q in braking.q:
            boom = scene.sms.at(q).end_effector_pose * scene.in_client
            ball_pose = (pin.XYZQUATToSE3(q[:7]) if on == "base" else root) * around.pose
            transforms = (coal.Transform3s(pose.rotation, pose.translation) for pose in (boom, ball_pose))
            shapes = zip((LONG, ball), transforms, strict=True)
            operands = [part for pair in shapes for part in pair]
            least = min(least, coal.distance(*operands, coal.DistanceRequest(), coal.DistanceResult()))
        distances.append(least)
    assert distances[0] < 0.0
    assert CLEARANCE <= clear.clearance <= distances[1] + 1e-6
    assert scene.by_coal(clear) >= CLEARANCE - 1e-6


def test_an_unavoidable_collision_is_predicted_before_the_flight() -> None:
    scene = Scene(*HOPELESS)
    held = scene.held_client(scene.q, scene.client.start_pose)
    braking = brake(scene.after, room=held)
    assert "satellite - boom come within -" in braking.note
    assert "10 mm are required" in braking.note
    assert braking.clearance < CLEARANCE
    assert braking.clearance >= held.least(brake(scene.after).q)[0]
    prediction = predicted(scene.sms, scene.q, scene.after.v, scene.client, 0.0, room=scene.held_client)
    assert "satellite - boom come within" in prediction.note


def test_the_clearance_does_not_change_braking_far_from_obstacles() -> None:
    scene = Scene(*BESIDE)
    scene.boom = Obstacle(
        coal.Box(0.06, 0.06, 0.1), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2])), name="box"
    )
    braking = brake(scene.after, room=scene.held_client(scene.q, scene.client.start_pose))
    np.testing.assert_array_equal(braking.q, brake(scene.after).q)
    assert braking.clearance > 0.05
    assert braking.nearest.endswith(" - box")
    with pytest.raises(InvalidValue, match="shapes"):
        HeldClient(scene.sms, [LONG], CLEARANCE, "auto", scene.q, scene.client.start_pose)


@pytest.mark.parametrize("coast", [0.0, 0.5, 1.0])
def test_joints_near_their_limits_rest_at_the_required_posture(coast: float) -> None:
    """A joint that brakes early to stay within its limit still ends at the required posture."""
    sms = ffsms.load("satellite_panda")
    joints = np.array([0.1, -0.4, 0.1, -2.0, 0.0, 2.1, 0.9])
    joints[0] = sms.limits.upper[0] - 0.15
    q = sms.configuration(joints)
    v = sms.velocity(q, 0.3 * np.eye(7)[0])
    end = joints - 0.1 * np.eye(7)[0]
    after = AfterCapture(sms, q, v, np.zeros(6), 0.0)
    motion = _braking(after, 3.0, sms.limits.torque, coast, end)
    np.testing.assert_allclose(sms.joint_positions(motion.q[-1]), end, atol=1e-4)
    np.testing.assert_allclose(motion.joint_rates[-1], 0.0, atol=1e-9)
