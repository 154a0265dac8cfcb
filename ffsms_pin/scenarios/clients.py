"""The client of a scenario file, and the goal to meet it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate, ClientSensor
from ffsms_pin.opt import Meet
from ffsms_pin.scenarios.contents import Contents
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import roll_out

__all__ = ["made_client", "meeting", "sensor"]

_STEPS = 200  # of the straight move that meets a client by construction


def made_client(scenario: Contents, sms: SpaceManipulator) -> Client:
    """The client of a scenario; its time zero is the start of the motion.

    Placed by `position` and `rpy`, these and `velocity` and `spin` are those at the start. Placed by `joints`
    they are those at the deadline, when its grasp is where a straight joint-space move to these joints,
    with rates that rise and fall smoothly, brings the end effector: so it can be met by construction.

    Raises
    ------
    InvalidValue
        An inertia that no body has.
    InvalidScenario
        Not one value a joint.
    """
    assert scenario.client is not None
    values = radians(scenario.client)
    twist = np.concatenate([values.get("velocity", np.zeros(3)), values.get("spin", np.zeros(3))])
    shapes = [coal.Box(*values["size"])] if "size" in values else []

    def client(pose: Any, twist: FloatArray) -> Client:
        return Client(values["mass"], np.array(values["inertia"]), pose, twist, shapes)

    if "position" in values:
        return client(_placement(values.get("rpy"), values["position"]), twist)
    joints = scenario.per_joint(sms, "client", "joints")
    assert joints is not None  # the schema asks for one of them
    duration, q0 = scenario.arrival, scenario.start_configuration(sms)
    s = np.linspace(0.0, 1.0, _STEPS + 1)
    way = joints - sms.joint_positions(q0)
    rates = (way / duration) * (30.0 * s**2 * (1.0 - s) ** 2)[:, None]
    dt = duration / _STEPS
    q, _ = roll_out(sms, q0, rates[0], np.diff(rates, axis=0) / dt, dt, scenario.plan.get("momentum"))
    then = client(sms.at(q[-1]).end_effector_pose * _grasp(scenario.meet or {}).inverse(), twist)
    return client(then.pose(-duration), then.twist(-duration))


def meeting(meet: Mapping[str, Any], client: Client | ClientEstimate) -> Meet:
    """The goal to meet a client, from the table [meet]."""
    values = radians(meet)
    others = {key: value for key, value in values.items() if key not in ("grasp", "grasp_rpy")}
    return Meet(client, _grasp(meet), **others)


def sensor(scenario: Contents) -> ClientSensor | None:
    """How the client is seen in the loop; None: where it is, is known."""
    given = None if scenario.client is None else scenario.client.get("sensor")
    return None if given is None else ClientSensor(**radians(given))


def _grasp(meet: Mapping[str, Any]) -> Any:
    values = radians(meet)
    return _placement(values.get("grasp_rpy"), values.get("grasp", (0.0, 0.0, 0.0)))


def _placement(rpy: Any, position: Any) -> Any:
    turn = np.eye(3) if rpy is None else pin.rpy.rpyToMatrix(np.array(rpy))
    return pin.SE3(turn, np.array(position))
