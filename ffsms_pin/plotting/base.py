"""How the base moves while the arm does."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.scenarios.extremes import base_motion
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_base_angular_velocity", "plot_base_position", "plot_base_rotation", "plot_base_velocity"]

_XYZ = ("x", "y", "z")


def _twists(sms: SpaceManipulator, trajectory: Trajectory) -> FloatArray:
    """Base twist (N + 1, 6), paper's convention."""
    return np.array([sms.at(q, v).base_twist for q, v in zip(trajectory.q, trajectory.v, strict=True)])


def plot_base_position(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Displacement of the base's centre of mass from its start, inertial axes."""
    moved = base_motion(sms, trajectory.q).translation
    return plot_series(ax, trajectory.t, 1e3 * moved, "base displacement [mm]", _XYZ)


def plot_base_velocity(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Velocity of the base's centre of mass, inertial axes."""
    velocity = _twists(sms, trajectory)[:, :3]
    return plot_series(ax, trajectory.t, 1e3 * velocity, "base velocity [mm/s]", _XYZ)


def plot_base_rotation(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Rotation vector of the base from its start, inertial axes."""
    turned = base_motion(sms, trajectory.q).rotation
    return plot_series(ax, trajectory.t, np.degrees(turned), "base rotation [deg]", _XYZ)


def plot_base_angular_velocity(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Angular velocity of the base, inertial axes."""
    velocity = _twists(sms, trajectory)[:, 3:]
    return plot_series(ax, trajectory.t, np.degrees(velocity), "base angular velocity [deg/s]", _XYZ)
