"""A Gymnasium environment: reach a place with a floating arm, by joint rates that a control law tracks.

Importing this module registers it as `ffsms-pin/Reach-v0`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.checks import FloatArray, instance, one_of, positive, vector, whole
from ffsms_pin.control import ComputedTorque
from ffsms_pin.extras import require
from ffsms_pin.models import load
from ffsms_pin.simulation.integrators import rk4_step
from ffsms_pin.system import SpaceManipulator

require("gym", "the environment")

import gymnasium as gym  # noqa: E402

gym.register("ffsms-pin/Reach-v0", "ffsms_pin.interchange.gymnasium_env:ReachEnv")

__all__ = ["ReachEnv"]

Observation = NDArray[np.float32]


class ReachEnv(gym.Env[Observation, Observation]):
    """Bring the end effector to a random place while the base reacts.

    An action is a share of each joint's rate limit, in [-1, 1]. The rates go there with the joints'
    acceleration limits and stop at the position limits; a control law turns the reference into torques, and
    the forward dynamics of the floating robot answer. Nothing acts on the base.

    An observation holds sine and cosine of the joints, joint rates over their limits, the target from the end
    effector in base axes [m], and the base's twist in its own axes [m/s; rad/s]. It is bounded: by twice the
    rate limits, twice the workspace, and twice the base motion that joint rates at their limits make, both as
    256 drawn postures show them; what lies beyond is cut off.

    The reward of a step is the way that the end effector came nearer [m], less a small price on the action,
    and 1 for arriving. An episode ends within `near` of the target, and is cut off after `duration`.

    Parameters
    ----------
    sms : SpaceManipulator or str
        A robot, or the name or path that `ffsms_pin.load` takes.
    start : array_like, shape (n,), optional
        Joint positions at the start of an episode [rad]; default: those of `sms.home()`.
    controller : optional
        Anything with `torque(q, v, q_d, qd_d, qdd_d)`; default computed torque.
    dt : float
        Time between actions [s].
    substeps : int
        Control steps between actions.
    duration : float
        Longest episode [s].
    near : float
        Distance that counts as arrived [m]; the default is the paper's r_th.
    render_mode : {"rgb_array"}, optional
        `render` gives a picture (480, 480, 3): base, arm and target. It needs `[plot]`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's own name and form)
    _PRICE = 1e-3  # of an action at its limits: a fraction of what a step can gain

    def __init__(
        self,
        sms: SpaceManipulator | str = "planar_3r",
        start: ArrayLike | None = None,
        controller: Any = None,
        dt: float = 0.05,
        substeps: int = 10,
        duration: float = 20.0,
        near: float = 0.02,
        render_mode: str | None = None,
    ) -> None:
        sms = load(sms) if isinstance(sms, str) else sms
        instance("sms", sms, SpaceManipulator)
        self.render_mode = None if render_mode is None else one_of("render_mode", render_mode, ["rgb_array"])
        self.sms, self.limits = sms, sms.limits
        self.lower = np.maximum(self.limits.lower, -np.pi)
        self.upper = np.minimum(self.limits.upper, np.pi)
        self.start = sms.joint_positions(sms.home()) if start is None else vector("start", start, sms.n)
        self.controller = ComputedTorque(sms) if controller is None else controller
        self.dt, self.substeps = positive("dt", dt, "s"), whole("substeps", substeps, 1)
        self.duration, self.near = positive("duration", duration, "s"), positive("near", near, "m")
        self.action_space = gym.spaces.Box(-1.0, 1.0, (sms.n,), np.float32)
        self._high = self._bounds()
        self.observation_space = gym.spaces.Box(-self._high, self._high, dtype=np.float32)
        self._data = sms.model.createData()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; `options={"target": (3,)}` sets the target [m], inertial axes.

        The target is where a random straight move of the joints ends, so it can be reached.
        """
        super().reset(seed=None if seed is None else whole("seed", seed, 0))
        instance("options", options, Mapping, optional=True)
        self.q = self.sms.configuration(self.start)
        self.v = np.zeros(self.sms.nv)
        self.q_d, self.qd_d, self.t = self.start.copy(), np.zeros(self.sms.n), 0.0
        if options and "target" in options:
            self.target = vector("target", options["target"], 3, "m")
        else:
            share = self.np_random.uniform(0.1, 0.9, self.sms.n)
            end = self.sms.configuration(self.lower + share * (self.upper - self.lower))
            self.target = np.asarray(self.sms.at(end).end_effector_pose.translation)
        self.distance = self._distance()
        return self._observation(), {"distance": self.distance}

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Follow an action for `dt`."""
        wanted = np.clip(vector("action", action, self.sms.n), -1.0, 1.0) * self.limits.velocity
        h = self.dt / self.substeps
        for _ in range(self.substeps):
            before = self.qd_d
            self.qd_d = self._allowed(wanted, h)
            qdd_d = (self.qd_d - before) / h
            tau = self.controller.torque(self.q, self.v, self.q_d, before, qdd_d)
            force = np.concatenate([np.zeros(6), np.clip(tau, -self.limits.torque, self.limits.torque)])
            self.q, self.v, _ = rk4_step(self.sms.model, self._data, self.q, self.v, force, h)
            self.q_d = self.q_d + 0.5 * h * (before + self.qd_d)
        self.t += self.dt
        last, self.distance = self.distance, self._distance()
        arrived = self.distance <= self.near
        price = self._PRICE * float(np.mean(np.square(action)))
        reward = last - self.distance - price + (1.0 if arrived else 0.0)
        over = self.t >= self.duration - 1e-9
        return self._observation(), float(reward), arrived, over, {"distance": self.distance, "time": self.t}

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of the state, where `render_mode` asks for one; planar arms are seen from above."""
        if self.render_mode is None:
            return None
        require("plot", "a picture of the environment")
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure((4.8, 4.8), dpi=100)  # [in]
        figure.set_layout_engine("none")  # whatever matplotlib's settings say
        canvas: Any = FigureCanvasAgg(figure)
        axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
        for line, colour in self._lines():
            axes.plot(*line, color=colour, linewidth=3.0)
        axes.plot(*self.target[:, None], "o", color="#D55E00", markersize=9.0)
        axes.set(**{f"{k}lim": (-self._size, self._size) for k in "xyz"})
        axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.6)  # the margins that axes would need
        axes.set_axis_off()
        axes.view_init(elev=90.0 if self._flat else 30.0, azim=-90.0 if self._flat else -60.0)
        canvas.draw()
        return np.array(canvas.buffer_rgba())[:, :, :3]

    def _lines(self) -> list[tuple[FloatArray, str]]:
        """Edges of the base's box, and the arm from joint to joint, as lines (3, 2) with their colours."""
        model, data, frame = self.sms.model, self._data, self.sms.frame_id
        pin.framesForwardKinematics(model, data, self.q)
        places = [pose.translation.copy() for pose in data.oMi]
        ends = [(int(model.parents[j]), places[j]) for j in range(2, model.njoints)]
        ends.append((int(model.frames[frame].parentJoint), data.oMf[frame].translation))
        lines = [(np.array([places[parent], end]).T, "#336B9F") for parent, end in ends]
        if self.sms.base_size is not None:
            placed, half = data.oMi[1] * self.sms.base_box_placement, 0.5 * np.array(self.sms.base_size)
            corners = half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
            for a, b in itertools.combinations(corners, 2):
                if (a != b).sum() == 1:  # neighbours
                    lines.append((np.array([placed.act(a), placed.act(b)]).T, "#8A857A"))
        return lines

    def _bounds(self) -> Observation:
        """Bounds of observations; and how large a picture must be."""
        sms, rng = self.sms, np.random.default_rng(0)
        drawn = self.lower + rng.uniform(size=(256, sms.n)) * (self.upper - self.lower)
        batch = sms.batch(drawn)
        span = np.ptp(batch.end_effector_position, axis=0)
        self._size = 1.1 * float(np.linalg.norm(batch.end_effector_position, axis=1).max())
        self._flat = bool(span[2] < 1e-6)
        base = 2.0 * (np.abs(batch.C_bm) @ self.limits.velocity).max(axis=0)
        way = np.full(3, 2.0 * float(span.max()))
        parts = [np.ones(2 * sms.n), np.full(sms.n, 2.0), way, base]
        return np.asarray(np.maximum(np.concatenate(parts), 1e-6), dtype=np.float32)

    def _allowed(self, wanted: FloatArray, h: float) -> FloatArray:
        """Joint rates as near to the wanted as accelerations allow, slow enough to stop at the limits."""
        a = self.limits.acceleration
        rates = self.qd_d + np.clip(wanted - self.qd_d, -a * h, a * h)
        up = np.sqrt(np.maximum(2.0 * a * (self.upper - self.q_d), 0.0)) - a * h
        down = np.sqrt(np.maximum(2.0 * a * (self.q_d - self.lower), 0.0)) - a * h
        return np.asarray(np.clip(rates, -np.maximum(down, 0.0), np.maximum(up, 0.0)))

    def _distance(self) -> float:
        tip = self.sms.at(self.q).end_effector_pose.translation
        return float(np.linalg.norm(self.target - tip))

    def _observation(self) -> Observation:
        state = self.sms.at(self.q, self.v)
        joints = self.sms.joint_positions(self.q)
        way = state.base_pose.rotation.T @ (self.target - state.end_effector_pose.translation)
        parts = [np.sin(joints), np.cos(joints), self.v[6:] / self.limits.velocity, way, self.v[:6]]
        whole = np.concatenate(parts).astype(np.float32)
        return np.clip(whole, -self._high, self._high)
