"""To and from other tools: tables (CSV, Parquet, pandas, xarray), ROS 2 messages, MuJoCo models, URDFs."""

from ffsms_pin.interchange.mjcf import to_mjcf
from ffsms_pin.interchange.tables import (
    read_csv,
    read_parquet,
    to_csv,
    to_dataframe,
    to_joint_trajectory,
    to_parquet,
    to_xarray,
)
from ffsms_pin.interchange.urdf import to_urdf

__all__ = [
    "read_csv",
    "read_parquet",
    "to_csv",
    "to_dataframe",
    "to_joint_trajectory",
    "to_mjcf",
    "to_parquet",
    "to_urdf",
    "to_xarray",
]
