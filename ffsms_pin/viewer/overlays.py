"""What is drawn on the moving robot: the coupling, and how much room its limits and clearances leave.

The dominant base motion u_1 scaled by sigma_1, as an arrow (translation) and a turn (rotation) at the base's
centre of mass; the end-effector motion J*_v v_i of each principal joint direction; the direction d to the
target; and the cone about d on which the paper's cost is zero, of half angle acos(c*).

The signs of u_i and v_i are arbitrary. They are chosen to agree with the motion, and kept where it rests.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.bodies import PointStack
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer import meshes
from ffsms_pin.viewer.around import Show
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.scene import Stage

_LEAST_RATE = 1e-6  # [rad/s] slower joint motion has no direction to agree with
_SAFE, _FREE = 0.01, 0.10  # [m] the paper's d_safe, and where room is plenty


class CouplingLayer:
    """Arrows that follow the frames, whose largest values set the lengths; each under its own node."""

    def __init__(self, stage: Stage, frames: Frames) -> None:
        self._stage = stage
        self._last_V: FloatArray | None = None
        radius = 0.011 * stage.size
        self._length = 0.42 * stage.size
        # They start inside of the base, so they must be seen through it.
        look: dict[str, Any] = {"flat": True, "through": True, "opacity": 0.9}
        colours = meshes.COLOURS
        stage.mesh("base motion u1/translation", meshes.arrow(1.3 * radius), colours["base_linear"], **look)
        stage.mesh("base motion u1/rotation", meshes.turn_arrow(0.05), colours["base_turn"], **look)
        self.shown = min(frames.sms.n, 6)
        for i in range(self.shown):  # paler for each further direction
            pale = 1.0 - (1.0 - meshes.rgb(colours["principal"])) * 0.72**i
            colour = "#" + "".join(f"{round(255 * x):02X}" for x in pale)
            stage.mesh(f"principal motions/v{i + 1}", meshes.arrow(0.8 * radius), colour)
        if frames.target is not None:
            stage.mesh("direction d", meshes.arrow(0.7 * radius), colours["direction"])
            stage.mesh("cone of the cost", meshes.cone(), "#FFFFFF", opacity=0.35, flat=True)
        self._linear, self._turn, self._principal = self._scales(frames)

    def show(self, frames: Frames, k: int) -> None:
        """Place everything as in frame k: at once, or where the scene is filming, in that frame."""
        stage = self._stage
        state = frames.states[k]
        coupling = state.coupling
        signs = self._agreeing(coupling.V, state.v[6:])
        base, tip = state.base_pose.translation, frames.tips[k]

        twist = signs[0] * coupling.sigma[0] * coupling.U[:, 0]
        self._arrow("base motion u1/translation", base, self._linear * twist[:3])
        turn = self._turn * float(np.linalg.norm(twist[3:]))
        stage.place("base motion u1/rotation", base, meshes.along_z(twist[3:]), turn)

        motions = state.J_star[:3] @ coupling.V * signs
        for i in range(self.shown):
            self._arrow(f"principal motions/v{i + 1}", tip, self._principal * motions[:, i])
        if frames.target is not None:
            self._towards(frames, k, tip)

    def _towards(self, frames: Frames, k: int, tip: FloatArray) -> None:
        assert frames.target is not None
        ahead = frames.target[k] - tip
        distance = float(np.linalg.norm(ahead))
        length = min(self._length, distance)
        direction = ahead / distance if distance > 1e-9 else np.zeros(3)
        self._arrow("direction d", tip, length * direction)
        cosine = float(frames.ideal[k])
        radius = 0.85 * length * float(np.sqrt(1.0 - cosine**2))
        scale = (radius, radius, 0.85 * length * cosine)
        self._stage.place("cone of the cost", tip, meshes.along_z(direction), scale)
        self._stage.tint("cone of the cost", meshes.assistance_colour(float(frames.assistance[k])))

    def _arrow(self, name: str, place: FloatArray, vector: FloatArray) -> None:
        length = float(np.linalg.norm(vector))
        # Short arrows get thinner, or they would be all head.
        width = min(1.0, length / (0.3 * self._length))
        self._stage.place(name, place, meshes.along_z(vector), (width, width, length))

    def _agreeing(self, V: FloatArray, rates: FloatArray) -> FloatArray:
        """Signs (n,) that make the columns of V agree with the motion, or with their last selves."""
        alpha = V.T @ rates
        signs = np.where(alpha < 0.0, -1.0, 1.0)
        if self._last_V is not None:
            still = np.abs(alpha) < _LEAST_RATE
            kept = np.where(np.einsum("ij,ij->j", V, self._last_V) < 0.0, -1.0, 1.0)
            signs = np.where(still, kept, signs)
        self._last_V = V * signs
        return np.asarray(signs)

    def _scales(self, frames: Frames) -> tuple[float, float, float]:
        """Metres in the scene for a unit of u_1's translation, of its rotation, and of principal motions."""
        largest = np.full(3, 1e-12)
        for state in frames.states[:: max(1, len(frames.t) // 60)]:
            twist = state.coupling.sigma[0] * state.coupling.U[:, 0]
            motions = np.linalg.norm(state.J_star[:3] @ state.coupling.V, axis=0)
            found = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:]), motions.max()
            largest = np.maximum(largest, found)
        linear, turn, principal = self._length * np.array([1.1, 0.62, 1.0]) / largest
        # Rounding is no motion: what is that small beside the rest of u_1 is not blown up.
        if largest[1] < 1e-9 * largest[0]:
            turn = 0.0
        if largest[0] < 1e-9 * largest[1]:
            linear = 0.0
        return float(linear), float(turn), float(principal)


def contact_layer(stage: Stage, frames: Frames) -> Show:
    """The force on the end effector, as an arrow at it; the largest so far is as long as can be."""
    look: dict[str, Any] = {"flat": True, "through": True}
    stage.mesh("contact force", meshes.arrow(0.014 * stage.size), meshes.COLOURS["contact"], **look)
    largest = 1e-12 if frames.force is None else float(np.linalg.norm(frames.force, axis=1).max())

    def show(frames: Frames, k: int) -> None:
        nonlocal largest
        force = np.zeros(3) if frames.force is None else frames.force[k]
        size = float(np.linalg.norm(force))
        largest = max(largest, size, 1e-12)
        share = size / largest
        scale = (share, share, share * 0.42 * stage.size)
        stage.place("contact force", frames.tips[k], meshes.along_z(force), scale)

    return show


def limit_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """A ball about each joint, coloured by how much of its position or rate limit is used, the larger."""
    data, names = sms.model.createData(), [f"joint limits/{i + 1}" for i in range(sms.n)]
    for name in names:
        stage.ball(name, 0.03 * stage.size, "#FFFFFF", opacity=0.85)

    def show(frames: Frames, k: int) -> None:
        pin.forwardKinematics(sms.model, data, frames.q[k])
        usage = limit_usage(sms, frames.q[k], frames.v[k])
        for i, name in enumerate(names):
            stage.place(name, np.array(data.oMi[i + 2].translation))
            stage.tint(name, meshes.usage_colour(float(usage[i])))

    return show


def clearance_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """A rod between the two of the paper's points, or the point and the base box, that are nearest.

    Its colour is red at the paper's d_safe, blue from 100 mm on.
    """
    stack, data, half = PointStack(sms), sms.model.createData(), 0.5 * np.array(sms.base_size)
    rod = meshes.tube(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 0.008 * stage.size)
    stage.mesh("clearance", rod, "#FFFFFF", flat=True)

    def show(frames: Frames, k: int) -> None:
        pin.framesForwardKinematics(sms.model, data, frames.q[k])
        values = stack.values(stack.at(frames.q[k], 0.0))[:, 0]
        nearest = int(np.argmin(values))
        points = [np.array(data.oMi[j].translation) for j in range(2, sms.model.njoints)]
        points.append(np.array(data.oMf[sms.frame_id].translation))
        one, other = stack.ends[nearest]
        start = points[one]
        if other >= 0:
            end = points[other]
        else:  # the base box
            box: Any = data.oMi[1] * sms.base_box_placement
            end = box.act(np.clip(box.actInv(start), -half, half))
        apart = end - start
        stage.place("clearance", start, meshes.along_z(apart), (1.0, 1.0, float(np.linalg.norm(apart))))
        usage = 1.0 - np.clip((values[nearest] - _SAFE) / (_FREE - _SAFE), 0.0, 1.0)
        stage.tint("clearance", meshes.usage_colour(float(usage)))

    return show


def limit_usage(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    """Share (n,) of each joint's limits that is used, 0 to 1: of position from the middle, or of rate."""
    limits = sms.limits
    bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    lower, upper = np.where(bounded, limits.lower, -1.0), np.where(bounded, limits.upper, 1.0)
    away = np.abs(sms.layout.positions(q) - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    position = np.where(bounded, away, 0.0)
    rate = np.abs(v[6:]) / limits.velocity
    return np.clip(np.maximum(position, rate), 0.0, 1.0)
