"""How the base moves while the arm does."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import Series, check_kinds, plot_flown
from ffsms_pin.simulation import Tracking
from ffsms_pin.studies.extremes import base_motion
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_base_angular_velocity", "plot_base_position", "plot_base_rotation", "plot_base_velocity"]

_XYZ = ("x", "y", "z")
_ROWS = 1000  # of a recording


Motion: TypeAlias = Trajectory | Tracking


def plot_base_position(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Displacement of the base's centre of mass from its start, inertial axes.

    With `flown`, that motion is drawn where it differs from the plan, and the plan thin and pale; so it is
    for the other panels of the base.
    """
    return _plot(sms, trajectory, flown, ax, "base displacement [mm]", _moved)


def plot_base_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Velocity of the base's centre of mass, inertial axes."""
    return _plot(sms, trajectory, flown, ax, "base velocity [mm/s]", _velocity)


def plot_base_rotation(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Rotation vector of the base from its start, inertial axes."""
    return _plot(sms, trajectory, flown, ax, "base rotation [deg]", _turned)


def plot_base_angular_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Angular velocity of the base, inertial axes."""
    return _plot(sms, trajectory, flown, ax, "base angular velocity [deg/s]", _spin)


def _plot(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    flown: Motion | None,
    ax: Axes | None,
    label: str,
    values: Callable[[SpaceManipulator, Motion, slice], FloatArray],
) -> Axes:
    check_kinds(sms=sms, trajectory=trajectory, flown=flown)
    planned = Series(trajectory.t, values(sms, trajectory, slice(None)))
    if flown is None:
        return plot_flown(ax, planned, None, label, _XYZ)
    some = slice(None, None, max(1, len(flown.t) // _ROWS))
    return plot_flown(ax, planned, Series(flown.t[some], values(sms, flown, some)), label, _XYZ)


def _moved(sms: SpaceManipulator, motion: Motion, rows: slice) -> FloatArray:
    return 1e3 * base_motion(sms, motion.q[rows]).translation


def _turned(sms: SpaceManipulator, motion: Motion, rows: slice) -> FloatArray:
    return np.degrees(base_motion(sms, motion.q[rows]).rotation)


def _velocity(sms: SpaceManipulator, motion: Motion, rows: slice) -> FloatArray:
    return 1e3 * _twists(sms, motion, rows)[:, :3]


def _spin(sms: SpaceManipulator, motion: Motion, rows: slice) -> FloatArray:
    return np.asarray(np.degrees(_twists(sms, motion, rows)[:, 3:]))


def _twists(sms: SpaceManipulator, motion: Motion, rows: slice) -> FloatArray:
    """Base twist (k, 6), paper's convention."""
    return np.array([sms.at(q, v).base_twist for q, v in zip(motion.q[rows], motion.v[rows], strict=True)])
