"""What a scenario file holds, its tables checked, and the robot and the start that they say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidScenario, InvalidValue
from ffsms_pin.models import SatelliteBase, load, mount, satellite_names
from ffsms_pin.models.mounting import face_placement
from ffsms_pin.scenarios.actuated import with_actuators
from ffsms_pin.scenarios.fits import DEFAULT_LAW
from ffsms_pin.scenarios.joint_values import joint_values, within_limits
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.urdf import model_names

__all__ = ["Contents"]


@dataclass(frozen=True)
class Contents:
    """The tables of a scenario file, checked: a robot, a start, a target, and how to plan and track.

    The page "Scenario files" of the documentation says what each key means. Tables that a file leaves out
    are empty here, and what they would set takes the library's defaults.

    Attributes
    ----------
    name : str
        The packaged name, or the file's name without its ending.
    source : Path
        The file.
    robot, start, target, plan, limits, control : mapping of str to values
        As in the file: SI units, radians, and degrees under keys that end in `_deg`.
    laws : mapping of str to mapping
        Gains of other control laws, for `compare_laws`.
    reference, simulation, plant, friction, actuator, sensors, estimator : mapping of str to values
        The closed loop under real conditions.
    disturbance, capture, fault : tuple of mappings
        What happens on the way.
    watchdog, wheels, thrusters, attitude : mapping of str to values, or None
        None: there is none, and for `attitude` that the base is left to itself.
    also, via : tuple of mappings
        Goals of other frames of the robot, and places that the end effector passes on its way.
    client, meet : mapping of str to values, or None
        Who is to be met in place of a target, and how; None: there is a target.
    contact : mapping of str to values
        How the client is caught, and what follows.
    term, limit : tuple of mappings
        Terms and limits of the plan beside, or in place of, those that `plan` describes.
    obstacle : tuple of mappings
        What the robot keeps clear of beside itself.
    campaign : mapping of str to values
        What a campaign draws; a single run does not use it.
    allow_import : bool
        Whether terms and limits may be a user's own, imported from Python modules.
    """

    name: str
    source: Path
    robot: Mapping[str, Any]
    start: Mapping[str, Any]
    target: Mapping[str, Any]
    plan: Mapping[str, Any]
    limits: Mapping[str, Any]
    control: Mapping[str, Any]
    laws: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    reference: Mapping[str, Any] = field(default_factory=dict)
    simulation: Mapping[str, Any] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)
    friction: Mapping[str, Any] = field(default_factory=dict)
    actuator: Mapping[str, Any] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    estimator: Mapping[str, Any] = field(default_factory=dict)
    disturbance: tuple[Mapping[str, Any], ...] = ()
    capture: tuple[Mapping[str, Any], ...] = ()
    fault: tuple[Mapping[str, Any], ...] = ()
    watchdog: Mapping[str, Any] | None = None
    wheels: Mapping[str, Any] | None = None
    thrusters: Mapping[str, Any] | None = None
    attitude: Mapping[str, Any] | None = None
    also: tuple[Mapping[str, Any], ...] = ()
    via: tuple[Mapping[str, Any], ...] = ()
    client: Mapping[str, Any] | None = None
    meet: Mapping[str, Any] | None = None
    contact: Mapping[str, Any] = field(default_factory=dict)
    term: tuple[Mapping[str, Any], ...] = ()
    limit: tuple[Mapping[str, Any], ...] = ()
    obstacle: tuple[Mapping[str, Any], ...] = ()
    campaign: Mapping[str, Any] = field(default_factory=dict)
    allow_import: bool = False

    def __repr__(self) -> str:
        kind, how = type(self).__name__, "re-planning" if self.replans else "plan"
        return f"{kind}('{self.name}': {self.robot['model']}, {how} of {self.arrival:g} s, {self.law})"

    @property
    def law(self) -> str:
        """Name of the control law, of `ffsms_pin.control.LAWS`."""
        return str(self.control.get("law", DEFAULT_LAW))

    @property
    def replans(self) -> bool:
        """Whether the motion is planned again in the loop."""
        return bool(self.reference.get("kind") == "re-planning")

    @property
    def arrival(self) -> float:
        """Time to arrive [s]."""
        return float(self.plan.get("duration", 12.0))

    @property
    def duration(self) -> float:
        """Time to simulate [s]: to arrive, and to hold the target."""
        return self.arrival + float(self.reference.get("hold", 0.0))

    @property
    def clearance(self) -> tuple[float, str]:
        """The clearance that the plan keeps [m], and between what."""
        (said,) = [part for part in self.limit if part["use"] == "clearance"][:1] or [self.plan]
        return float(said.get("clearance", 0.01)), str(said.get("collision", "auto"))

    def load(self) -> SpaceManipulator:
        """The robot, with the limits, wheels and thrusters that the scenario sets.

        Raises
        ------
        FfsmsError
            What `ffsms_pin.load` raises; `InvalidScenario` where limits do not fit the robot.
        """
        try:
            sms = self._robot()
        except InvalidValue as error:
            raise InvalidScenario(self.source, f"[robot] {error}") from None
        try:
            limits = {
                name: self.per_joint(sms, "limits", name)
                for name in ("lower", "upper", "velocity", "acceleration", "torque")
            }
            chosen = {name: value for name, value in limits.items() if value is not None}
            if chosen:
                sms = sms.with_limits(replace(sms.limits, **chosen))
            sms = with_actuators(sms, self.wheels, self.thrusters)
        except InvalidValue as error:
            raise InvalidScenario(self.source, str(error)) from None
        return sms

    def _robot(self) -> SpaceManipulator:
        """The robot of [robot]: a whole one, or an arm on the satellite of [robot.mount]."""
        options = radians({key: value for key, value in self.robot.items() if key != "mount"})
        model = options.pop("model")
        if "package_dirs" in options:
            options["package_dirs"] = [self.source.parent / folder for folder in options["package_dirs"]]
        if "mount" not in self.robot:
            return load(self.robot_path(model), **options)
        satellite = radians(self.robot["mount"])
        place: dict[str, Any] = {key: satellite.pop(key) for key in ("position", "rpy") if key in satellite}
        base = SatelliteBase(**satellite)
        arm = self.source.parent / model
        return mount(arm if arm.is_file() else model, base, _placement(base, place), **options)

    def robot_path(self, model: str) -> str | Path:
        """What `load` takes for a robot of the file: a known name, or a path from the file's folder."""
        return model if model in (*model_names(), *satellite_names()) else self.source.parent / model

    def start_configuration(self, sms: SpaceManipulator) -> FloatArray:
        """Start q0 (nq,) of the plan: the system's centre of mass at the inertial origin, at rest."""
        joints = self.per_joint(sms, "start", "joints")
        assert joints is not None  # the schema asks for it
        return sms.configuration(within_limits(self.source, sms, "start", "joints", joints))

    def per_joint(self, sms: SpaceManipulator, table: str, key: str) -> FloatArray | None:
        """Values (n,) of a key that has one a joint, in radians and metres; None where it is not given."""
        return joint_values(self.source, sms, table, getattr(self, table), key)


def _placement(base: SatelliteBase, given: Mapping[str, Any]) -> Any:
    """Pose (pinocchio.SE3) of the arm's root link in the base frame: what is not given is the default's."""
    default = face_placement(base)
    turn = pin.rpy.rpyToMatrix(np.array(given["rpy"])) if "rpy" in given else default.rotation
    return pin.SE3(turn, np.array(given.get("position", default.translation)))
