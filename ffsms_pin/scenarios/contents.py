"""What a scenario file holds, its tables checked, and the robot and the start that they say."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray
from ffsms_pin.models import SatelliteBase, load, mount, satellite_names
from ffsms_pin.models.mounting import face_placement
from ffsms_pin.scenarios.fits import DEFAULT_LAW
from ffsms_pin.scenarios.joints import joint_values, within_limits
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.scenarios.naming import named
from ffsms_pin.scenarios.robot_tables import Limits
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.urdf import model_names

__all__ = ["Contents"]


@dataclass(frozen=True)
class Contents:
    """The tables of a scenario file, checked; the page "Scenario files" says what their keys mean.

    Tables that a file leaves out are empty here, or None where that is another thing than an empty one; what
    they would set takes the library's defaults. Values are as in the file: SI units, radians, and degrees
    under keys that end in `_deg`.

    Attributes
    ----------
    name : str
        The packaged name, or the file's name without its ending.
    source : Path
        The file.
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
            What `ffsms_pin.load` raises, with the key of the file; `InvalidScenario` for a value.
        """
        with self.named("robot"):
            sms = self._robot()
        with self.named("limits"):
            limits = {name: self.per_joint(sms, "limits", name) for name in Limits.model_fields}
            chosen = {name: value for name, value in limits.items() if value is not None}
            if chosen:
                sms = sms.with_limits(replace(sms.limits, **chosen))
        with self.named():
            wheels = sms.wheels if self.wheels is None else ReactionWheels(**self.wheels)
            thrusters = None if self.thrusters is None else Thrusters(**self.thrusters)
            if self.wheels is not None or thrusters is not None:
                sms = sms.with_actuators(wheels=wheels, thrusters=thrusters)
        return sms

    def named(self, under: str = "") -> AbstractContextManager[None]:
        """Errors of the library inside it name the file and the key, of the table `under` if given."""
        return named(self.source, vars(self), under)

    def _robot(self) -> SpaceManipulator:
        """The robot of [robot]: a whole one, or an arm on the satellite of [robot.mount]."""
        options = radians({key: value for key, value in self.robot.items() if key != "mount"})
        model = options.pop("model")
        if "package_dirs" in options:
            options["package_dirs"] = [self.source.parent / folder for folder in options["package_dirs"]]
        if "mount" not in self.robot:
            return load(self.robot_path(model), **options)
        satellite = radians(self.robot["mount"])
        place = {key: np.array(satellite.pop(key)) for key in ("position", "rpy") if key in satellite}
        base = SatelliteBase(**satellite)
        default = face_placement(base)
        turn = pin.rpy.rpyToMatrix(place["rpy"]) if "rpy" in place else default.rotation
        arm = self.source.parent / model
        placement = pin.SE3(turn, place.get("position", default.translation))
        return mount(arm if arm.is_file() else model, base, placement, **options)

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
