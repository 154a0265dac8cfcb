"""The export of robots (URDF, MuJoCo's MJCF) and of motions (CSV, pandas data frames, ROS 2 messages)."""

from ffsms_pin.export.mjcf import to_mjcf
from ffsms_pin.export.ros import to_joint_trajectory
from ffsms_pin.export.tables import read_csv, to_csv, to_dataframe
from ffsms_pin.export.urdf import to_urdf

__all__ = [
    "read_csv",
    "to_csv",
    "to_dataframe",
    "to_joint_trajectory",
    "to_mjcf",
    "to_urdf",
]
