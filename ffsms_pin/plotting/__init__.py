"""Figures: each function draws one panel, on axes that are given or on a new figure, and returns the axes."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later, require

require("plot", "drawing figures")

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.plotting.coupling import (
        entropy_grid as entropy_grid,
        plot_assistance as plot_assistance,
        plot_cost as plot_cost,
        plot_entropy as plot_entropy,
        plot_entropy_map as plot_entropy_map,
        plot_position_error as plot_position_error,
        plot_sigma as plot_sigma,
        plot_sigma_bands as plot_sigma_bands,
    )
    from ffsms_pin.plotting.figures import (
        FIGURES as FIGURES,
        figure as figure,
        save_figure as save_figure,
        save_figures as save_figures,
        save_formats as save_formats,
    )
    from ffsms_pin.plotting.joints import (
        plot_base_angular_velocity as plot_base_angular_velocity,
        plot_base_position as plot_base_position,
        plot_base_rotation as plot_base_rotation,
        plot_base_velocity as plot_base_velocity,
        plot_joint_error as plot_joint_error,
        plot_joint_positions as plot_joint_positions,
        plot_joint_rate_error as plot_joint_rate_error,
        plot_joint_rates as plot_joint_rates,
        plot_torques as plot_torques,
        plot_tracked_position_error as plot_tracked_position_error,
        plot_wheel_momentum as plot_wheel_momentum,
        plot_wheel_torque as plot_wheel_torque,
        plot_wheels as plot_wheels,
    )
    from ffsms_pin.plotting.motion import motion_sides as motion_sides, plot_motion as plot_motion
    from ffsms_pin.plotting.series import (
        plot_bands as plot_bands,
        plot_error_bands as plot_error_bands,
        plot_series as plot_series,
    )
else:
    __getattr__, __dir__, __all__ = later(__name__)
