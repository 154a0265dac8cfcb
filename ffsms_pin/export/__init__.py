"""Robots and motions for other tools: URDF, MuJoCo's MJCF, CSV, pandas data frames, ROS 2 messages."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.export.mjcf import to_mjcf as to_mjcf
    from ffsms_pin.export.ros import to_joint_trajectory as to_joint_trajectory
    from ffsms_pin.export.tables import read_csv as read_csv, to_csv as to_csv, to_dataframe as to_dataframe
    from ffsms_pin.export.urdf import to_urdf as to_urdf
else:
    __getattr__, __dir__, __all__ = later(__name__)
