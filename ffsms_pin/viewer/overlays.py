"""Overlays on the moving robot: the coupling, the contact force, the use of limits, and clearances.

Four parts show the coupling:

- the dominant base motion sigma_1 u_1, as an arrow (translation) and a curved arrow (rotation) at the base's
  centre of mass;
- the end-effector velocity J*_v v_i for each principal joint direction v_i;
- the direction d from the end effector to the target;
- the cone about d with half angle acos(c*), on which the paper's cost is smallest.

The coupling matrix C_bm has the singular values sigma_i and singular vectors u_i, v_i. J*_v is the linear
part of the generalized Jacobian, and c* is the cosine `Frames.ideal`.

The singular vectors u_i and v_i have arbitrary signs. The signs are chosen to agree with the motion, and kept
while the joints rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import PointStack
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.viewer import meshes
from ffsms_pin.viewer.environment import Show
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.scene import Stage

_SAFE, _FREE = 0.01, 0.10  # [m] clearances at the ends of the colour scale; _SAFE is the paper's d_safe
_LONGEST = 0.42  # length of the longest arrow, as a share of `Stage.size`


def coupling_layer(stage: Stage, frames: Frames) -> Show:
    """Draw the arrows and the cone of the coupling, with a constant scale for each kind of arrow."""
    radius, longest, colours = 0.011 * stage.size, _LONGEST * stage.size, meshes.COLOURS
    # The arrows of the base motion begin inside the base, so they must be visible through it.
    look: dict[str, Any] = {"flat": True, "through": True, "opacity": 0.9}
    stage.draw("base motion u1/translation", meshes.arrow(1.3 * radius), colours["base_linear"], **look)
    stage.draw("base motion u1/rotation", meshes.turn_arrow(0.05), colours["base_turn"], **look)
    principal = [f"principal motions/v{i + 1}" for i in range(min(frames.sms.n, 6))]
    for i, name in enumerate(principal):  # later directions are paler
        stage.draw(name, meshes.arrow(0.8 * radius), meshes.pale(colours["principal"], 0.72**i))
    if frames.target is not None:
        stage.draw("direction d", meshes.arrow(0.7 * radius), colours["direction"])
        stage.draw("cone of the cost", meshes.cone(), "#FFFFFF", opacity=0.35, flat=True)
    linear, turn, moved = _scales(frames) * longest
    last: FloatArray | None = None

    def arrow(name: str, place: FloatArray, vector: FloatArray) -> None:
        length = float(np.linalg.norm(vector))
        width = min(1.0, length / (0.3 * longest))  # short arrows are thinner, to show their shaft
        stage.place(name, place, meshes.along_z(vector), (width, width, length))

    def show(frames: Frames, k: int) -> None:
        nonlocal last
        state, coupling = frames.states[k], frames.states[k].coupling
        signs = _agreeing(coupling.V, state.v[6:], last)
        last = coupling.V * signs
        base, tip = state.base_pose.translation, frames.tips[k]
        twist = signs[0] * coupling.sigma[0] * coupling.U[:, 0]
        arrow("base motion u1/translation", base, linear * twist[:3])
        size = turn * float(np.linalg.norm(twist[3:]))
        stage.place("base motion u1/rotation", base, meshes.along_z(twist[3:]), size)
        for name, motion in zip(principal, (state.J_star[:3] @ last).T, strict=False):
            arrow(name, tip, moved * motion)
        if frames.target is None:
            return
        ahead = frames.target[k] - tip
        distance, cosine = float(np.linalg.norm(ahead)), float(frames.ideal[k])
        length = min(longest, distance)
        arrow("direction d", tip, ahead * (length / max(distance, 1e-9)))
        radius = 0.85 * length * float(np.sqrt(1.0 - cosine**2))
        stage.place("cone of the cost", tip, meshes.along_z(ahead), (radius, radius, 0.85 * length * cosine))
        colour = meshes.blend(meshes.ASSISTANCE_STOPS, 0.5 + 0.5 * frames.assistance[k])
        stage.tint("cone of the cost", colour)

    return show


def _agreeing(V: FloatArray, rates: FloatArray, last: FloatArray | None) -> FloatArray:
    """Return signs (n,) for which the columns of V agree with the joint rates, or with `last` at rest."""
    alpha = V.T @ rates
    if last is not None:  # rates below 1e-6 rad/s are rounding errors
        alpha = np.where(np.abs(alpha) < 1e-6, np.einsum("ij,ij->j", V, last), alpha)
    return np.where(alpha < 0.0, -1.0, 1.0)


def _scales(frames: Frames) -> FloatArray:
    """Return the scales (3,) of the arrows for u_1's translation, u_1's rotation and principal motions.

    The largest vectors at a sample of the frames set the scales.
    """
    states = frames.states[:: max(1, len(frames.t) // 60)]
    twists = np.array([state.coupling.sigma[0] * state.coupling.U[:, 0] for state in states])
    motions = [np.linalg.norm(state.J_star[:3] @ state.coupling.V, axis=0).max() for state in states]
    u1 = np.linalg.norm(twists.reshape(-1, 2, 3), axis=2).max(axis=0)
    largest = np.maximum([*u1, max(motions)], 1e-12)
    # Hide the translation or rotation of u_1 if it is below rounding errors.
    real = largest > 1e-9 * largest[[1, 0, 2]]
    return np.asarray(real * np.array([1.1, 0.62, 1.0]) / largest)


def contact_layer(stage: Stage, forces: FloatArray) -> Show:
    """Draw forces (k, 3) on the end effector as an arrow whose length is proportional to the force."""
    arrow, colour = meshes.arrow(0.014 * stage.size), meshes.COLOURS["contact"]
    stage.draw("contact force", arrow, colour, flat=True, through=True)
    sizes = np.linalg.norm(forces, axis=1)
    shares = sizes / max(1e-12, float(sizes.max()))

    def show(frames: Frames, k: int) -> None:
        scale = shares[k] * np.array([1.0, 1.0, _LONGEST * stage.size])
        stage.place("contact force", frames.tips[k], meshes.along_z(forces[k]), scale)

    return show


def limit_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """Draw a ball at each joint, coloured by `limit_usage`."""
    names, ball = [f"joint limits/{i + 1}" for i in range(sms.n)], meshes.sphere(0.03 * stage.size)
    for name in names:
        stage.draw(name, ball, "#FFFFFF", opacity=0.85, flat=True, through=True)

    def show(frames: Frames, k: int) -> None:
        usage = limit_usage(sms, frames.q[k], frames.v[k])
        colours = meshes.blend(meshes.USAGE_STOPS, usage)
        for name, place, colour in zip(names, frames.points[k, :-1], colours, strict=True):
            stage.place(name, place)
            stage.tint(name, colour)

    return show


def clearance_layer(stage: Stage, sms: SpaceManipulator) -> Show:
    """Draw a rod at the least clearance between two of the paper's points, or a point and the base box.

    The rod is red up to the paper's d_safe, and blue from a clearance of 100 mm on.
    """
    stack, half = PointStack(sms), 0.5 * np.array(sms.base_size)
    rod = meshes.tube(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 0.008 * stage.size)
    stage.draw("clearance", rod, "#FFFFFF", flat=True)

    def show(frames: Frames, k: int) -> None:
        values = stack.values(stack.at(frames.q[k], 0.0))[:, 0]
        first, second = stack.ends[np.argmin(values)]
        start, end = frames.points[k, first], frames.points[k, second]
        if second < 0:  # `second` is the base box
            box = frames.bases[k] * sms.base_box_placement
            end = box.act(np.clip(box.actInv(start), -half, half))
        scale = (1.0, 1.0, float(np.linalg.norm(end - start)))
        stage.place("clearance", start, meshes.along_z(end - start), scale)
        usage = (_FREE - float(values.min())) / (_FREE - _SAFE)
        stage.tint("clearance", meshes.blend(meshes.USAGE_STOPS, usage))

    return show


def limit_usage(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the larger used share (n,), 0 to 1, of each joint's position range and rate limit.

    The middle of the position range uses a share of 0, a position limit a share of 1.
    """
    limits = sms.limits
    with np.errstate(invalid="ignore"):  # a continuous joint has infinite limits
        middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
        away = np.nan_to_num(np.abs(sms.layout.positions(q) - middle) / half)
    return np.clip(np.maximum(away, np.abs(v[6:]) / limits.velocity), 0.0, 1.0)
