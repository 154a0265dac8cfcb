"""The robot class `SpaceManipulator`, and functions that load robots and mount arms on satellites."""

from ffsms_pin.robot.base import SatelliteBase
from ffsms_pin.robot.building import with_srdf
from ffsms_pin.robot.loading import load, satellite_names
from ffsms_pin.robot.manipulator import SpaceManipulator
from ffsms_pin.robot.mounting import mount

__all__ = ["SatelliteBase", "SpaceManipulator", "load", "mount", "satellite_names", "with_srdf"]
