"""Figures of motions. Each function `plot_*` of this package draws one panel on existing or new axes."""

from ffsms_pin.errors import require

require("plot", "drawing figures")

# ruff: noqa: E402  # the check must run before the imports, so that its message is shown
from ffsms_pin.plotting.coupling import (
    entropy_grid,
    plot_assistance,
    plot_cost,
    plot_entropy,
    plot_entropy_map,
    plot_position_error,
    plot_sigma,
    plot_sigma_bands,
)
from ffsms_pin.plotting.figures import FIGURES, figure, save_figure, save_figures, save_formats
from ffsms_pin.plotting.motion import motion_sides, plot_motion
from ffsms_pin.plotting.series import (
    plot_bands,
    plot_base_angular_velocity,
    plot_base_position,
    plot_base_rotation,
    plot_base_velocity,
    plot_error_bands,
    plot_joint_error,
    plot_joint_positions,
    plot_joint_rate_error,
    plot_joint_rates,
    plot_series,
    plot_torques,
    plot_tracked_position_error,
    plot_wheel_momentum,
    plot_wheel_torque,
    plot_wheels,
)

__all__ = [
    "FIGURES",
    "entropy_grid",
    "figure",
    "motion_sides",
    "plot_assistance",
    "plot_bands",
    "plot_base_angular_velocity",
    "plot_base_position",
    "plot_base_rotation",
    "plot_base_velocity",
    "plot_cost",
    "plot_entropy",
    "plot_entropy_map",
    "plot_error_bands",
    "plot_joint_error",
    "plot_joint_positions",
    "plot_joint_rate_error",
    "plot_joint_rates",
    "plot_motion",
    "plot_position_error",
    "plot_series",
    "plot_sigma",
    "plot_sigma_bands",
    "plot_torques",
    "plot_tracked_position_error",
    "plot_wheel_momentum",
    "plot_wheel_torque",
    "plot_wheels",
    "save_figure",
    "save_figures",
    "save_formats",
]
