"""To and from other tools: tables (CSV, Parquet, pandas, xarray), ROS 2 messages, MuJoCo models."""

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

__all__ = [
    "read_csv",
    "read_parquet",
    "to_csv",
    "to_dataframe",
    "to_joint_trajectory",
    "to_mjcf",
    "to_parquet",
    "to_xarray",
]
