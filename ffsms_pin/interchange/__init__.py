"""To and from other tools: tables (CSV, Parquet, pandas, xarray), ROS 2 messages, MuJoCo models, URDFs."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.interchange.robots import to_mjcf as to_mjcf, to_urdf as to_urdf
    from ffsms_pin.interchange.tables import (
        read_csv as read_csv,
        read_parquet as read_parquet,
        to_csv as to_csv,
        to_dataframe as to_dataframe,
        to_joint_trajectory as to_joint_trajectory,
        to_parquet as to_parquet,
        to_xarray as to_xarray,
    )
else:
    __getattr__, __dir__, __all__ = later(__name__)
