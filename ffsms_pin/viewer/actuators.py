"""What acts on the base, in the scene: reaction wheels as discs on its faces, thrusters as nozzles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer.colours import COLOURS
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import along_z, nozzle, tube
from ffsms_pin.viewer.stage import Stage

__all__ = ["add_actuators"]

_WHEEL, _THICK = 0.16, 0.05  # radius and thickness of a disc, in shares of the base's smallest edge
_NOZZLE = 0.14  # length of a nozzle, likewise
_NO_BOX = 0.3  # smallest edge of a base without a box, in shares of the robot's size


def add_actuators(stage: Stage, frames: Frames) -> None:
    """Draw the robot's wheels and thrusters, and film them with the base."""
    sms = frames.sms
    edge = _NO_BOX * stage.size if sms.base_size is None else float(min(sms.base_size))
    drawn = []
    if sms.wheels is not None:
        drawn.append("wheels")
        thick = _THICK * edge
        ends = np.array([[0.0, 0.0, -0.5 * thick], [0.0, 0.0, 0.5 * thick]])
        for i, (place, axis) in enumerate(zip(_on_faces(sms, edge), sms.wheels.axes, strict=True)):
            stage.mesh(f"wheels/{i}", tube(ends, _WHEEL * edge, sides=32), COLOURS["wheel"])
            stage.place(f"wheels/{i}", place, along_z(axis))
    if sms.thrusters is not None:
        drawn.append("thrusters")
        for i, (place, push) in enumerate(zip(sms.thrusters.places, sms.thrusters.directions, strict=True)):
            stage.mesh(f"thrusters/{i}", nozzle(_NOZZLE * edge), COLOURS["thruster"])
            stage.place(f"thrusters/{i}", place, along_z(-push))  # it opens to where the jet goes
    for name in drawn:
        for k, t in enumerate(frames.t):
            pose = pin.XYZQUATToSE3(frames.q[k, :7])
            if k == 0:
                stage.place(name, pose.translation, pose.rotation)
            with stage.scene.filming(stage.film, float(t - frames.t[0])):
                stage.place(name, pose.translation, pose.rotation)


def _on_faces(sms: SpaceManipulator, edge: float) -> FloatArray:
    """Places (w, 3) for discs, root frame: where each axis leaves the base's box, one beyond the other.

    A robot's wheels have axes and no places, since their places do not matter to the motion. Of the two faces
    that an axis leaves by, it is the one further from where the arm begins.
    """
    assert sms.wheels is not None
    box, arm = sms.base_box_placement, np.array(sms.model.jointPlacements[2].translation)
    half = 0.5 * np.full(3, edge) if sms.base_size is None else 0.5 * np.asarray(sms.base_size)
    found: list[FloatArray] = []
    for axis in sms.wheels.axes:
        out = float(np.min(half / np.maximum(np.abs(box.rotation.T @ axis), 1e-9)))
        sides = [np.array(box.translation + sign * out * axis) for sign in (-1.0, 1.0)]
        place = max(sides, key=lambda side: float(np.linalg.norm(side - arm)))
        step = 3.0 * _THICK * edge * np.sign((place - box.translation) @ axis) * axis
        while any(np.linalg.norm(place - other) < 2.0 * _THICK * edge for other in found):
            place = place + step
        found.append(place)
    return np.array(found)
