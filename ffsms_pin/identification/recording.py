"""The recorded motion for an identification, and its checks.

Positions are compared with integrated velocities, channel by channel over windows of the recording. They
disagree if a sensor is frozen, if values are in degrees, or if the base's velocity is in other axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, instance, one_of, reals
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification.noise import noise_of
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking
from ffsms_pin.system.batch.stacks import apply, log3, rotations

_GAP = 5.0  # least length of a gap, as a multiple of the usual step
_USUAL = 90.0  # percentile of the time steps that is the usual step, because samples may be irregular
_WINDOWS = 24  # least number of windows of a recording with more than 24 samples
_NOISE = 8.0  # least RMS motion of the windows for a comparison, as a multiple of its noise
# Allowed difference of positions and integrated velocities in addition to noise, as a share of the motion.
_AGREES = 0.2
_FARTHEST = 3.0  # largest accepted position, as a multiple of one radian plus the position limit
_FASTEST = 10.0  # largest accepted rate, as a multiple of the limit; impacts are slower, deg/s are faster
_DEGREES = 180.0 / np.pi
_TURN = 1.0  # [rad] largest mean rotation of the base in a window
_ALTERNATIVE = 0.3  # largest disagreement in the right axes, as a share of that in the stated axes
_MILLI = 3.0  # factor by which wrong masses may change the model's base velocity
_SOME = 200  # largest number of samples for the comparison of the base's velocity with the model's

BASE_VELOCITIES = {
    "local": "linear and angular velocity in the root's axes",
    "mixed": "linear velocity in inertial and angular velocity in the root's axes",
    "inertial": "linear and angular velocity in inertial axes",
}
"""The possible axes of a recorded base velocity, by the value of `base_velocity`."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A recorded motion of N samples.

    Attributes
    ----------
    t : ndarray, shape (N,)
        The times of the samples [s].
    q, v : ndarray, shape (N, nq) and (N, 6 + n)
        Configurations and velocities in Pinocchio's layout.
    tau : ndarray, shape (N - 1, n) or None
        Joint torques [N m], each constant from a sample to the next sample.
    wheel_momentum : ndarray, shape (N, w) or None
        Spin momenta of the wheels relative to the base [N m s].
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    tau: FloatArray | None = None
    wheel_momentum: FloatArray | None = None


def recording_of(
    sms: SpaceManipulator,
    tracking: Tracking | None,
    recording: Any,
    wheel_momentum: Any,
    torques: bool,
    base_velocity: str,
) -> Recording:
    """Return a checked recording, from a `Tracking` or from arrays (t, q, v[, tau])."""
    one_of("base_velocity", base_velocity, BASE_VELOCITIES)
    if (tracking is None) == (recording is None):
        neither = "must be given as (t, q, v) or (t, q, v, tau), because no tracking is given"
        both = "must be left out, because a tracking is given (one of the two, not both)"
        raise InvalidValue("recording", recording, neither if tracking is None else both)
    if tracking is None:
        made = _of_arrays(sms, recording, wheel_momentum)
    else:
        instance("tracking", tracking, Tracking)
        if wheel_momentum is not None:
            text = "must be left out: the Tracking has its own"
            raise InvalidValue("wheel_momentum", wheel_momentum, text)
        if base_velocity != "local":
            text = 'must be "local", the axes of the velocity in a Tracking'
            raise InvalidValue("base_velocity", base_velocity, text)
        made = _of_tracking(sms, tracking, torques)
    _check_times(made.t)
    _check_units(sms, made)
    _check_axes(sms, made, base_velocity)
    made = _in_root_axes(made, base_velocity)
    _check_size(sms, made)
    _check_agreement(sms, made)
    return _with_positions(made)


def _in_root_axes(recording: Recording, base_velocity: str) -> Recording:
    """Return the recording with the base's velocity in the root's axes."""
    v, back = recording.v.copy(), rotations(recording.q[:, 3:7].T).swapaxes(0, 1)
    if base_velocity != "local":
        v[:, :3] = apply(back, v[:, :3].T).T
    if base_velocity == "inertial":
        v[:, 3:6] = apply(back, v[:, 3:6].T).T
    return replace(recording, v=v)


def _with_positions(recording: Recording) -> Recording:
    """Return the recording; integrate the base's velocity if its positions are not measured (NaN)."""
    if not np.isnan(recording.q[:, :3]).all():
        return recording
    q, velocity = recording.q.copy(), _inertial_velocity(recording)
    travel = 0.5 * np.diff(recording.t)[:, None] * (velocity[1:] + velocity[:-1])
    q[0, :3], q[1:, :3] = 0.0, np.nan_to_num(np.cumsum(travel, axis=0))
    return replace(recording, q=q)


def _inertial_velocity(recording: Recording) -> FloatArray:
    """Return the linear velocity of the base (N, 3) in inertial axes."""
    return apply(rotations(recording.q[:, 3:7].T), recording.v[:, :3].T).T


def _of_tracking(sms: SpaceManipulator, tracking: Tracking, torques: bool) -> Recording:
    if (tracking.q.shape[1], tracking.v.shape[1]) != (sms.nq, sms.nv):
        raise InvalidValue("tracking", tracking, f"must be of a robot with {sms.n} joints")
    change = np.abs(tracking.impulse - tracking.impulse[0]).max(axis=1)
    if (moved := change > 1e-9 * (1.0 + np.abs(tracking.momentum).max())).any():
        time = float(tracking.t[int(np.argmax(moved))])
        text = f"has external forces (thrusters or disturbances) at {time:.4g} s, so that its momentum is"
        text += " not constant; use the rows before or after them: tracking.between(start, end)"
        raise InvalidValue("tracking", tracking, text)
    if tracking.contact_wrench.any():
        touching = np.flatnonzero(tracking.contact_wrench.any(axis=1))
        if len(touching) < len(tracking.t) - 1:
            time = float(tracking.t[touching[0]])
            text = f"touches its client from {time:.4g} s on; use the rows before the contact, or with"
            text += " unknown=['payload'] the rows of the latched client: tracking.between(start, end)"
            raise InvalidValue("tracking", tracking, text)
    wheels = tracking.wheel_momentum if tracking.wheel_momentum.shape[1] else None
    return Recording(tracking.t, tracking.q, tracking.v, tracking.tau if torques else None, wheels)


def _of_arrays(sms: SpaceManipulator, recording: Any, wheel_momentum: Any) -> Recording:
    if not isinstance(recording, (tuple, list)) or len(recording) not in (3, 4):
        raise InvalidValue("recording", recording, "must be a tuple (t, q, v) or (t, q, v, tau)")
    names = ("t", "q", "v", "tau")
    arrays = [reals(f"recording {name}", value) for name, value in zip(names, recording, strict=False)]
    t, q, v, *torque = arrays
    if t.ndim != 1:
        raise InvalidValue("recording t", t, f"must have shape (N,) but has {t.shape}")
    shapes: list[tuple[str, FloatArray, tuple[int, ...]]] = [
        ("q", q, (len(t), sms.nq)),
        ("v", v, (len(t), sms.nv)),
    ]
    if wheel_momentum is not None:
        if sms.wheels is None:
            text = "must be left out: the robot has no wheels"
            raise InvalidValue("wheel_momentum", wheel_momentum, text)
        wheel_momentum = reals("wheel_momentum", wheel_momentum)
        shapes.append(("wheel_momentum", wheel_momentum, (len(t), len(sms.wheels))))
    tau = torque[0] if torque else None
    if tau is not None:
        if tau.ndim == 2 and len(tau) == len(t):
            tau = tau[:-1]  # the last torque acts after the recording
        shapes.append(("tau", tau, (len(t) - 1, sms.n)))
    for name, array, shape in shapes:
        label = name if name == "wheel_momentum" else f"recording {name}"
        if array.shape != shape:
            raise InvalidValue(label, array, f"must have shape {shape} but has {array.shape}")
        measured = array[:, 3:] if name in "qv" and np.isnan(array[:, :3]).all() else array
        if not np.isfinite(measured).all():
            base = "; a position or a linear velocity of the base that is not measured is NaN in all rows"
            raise InvalidValue(label, array, "must be finite" + base * (name in "qv"))
    # q and -q are the same attitude, so each quaternion gets the sign of the previous row.
    q = q.copy()
    q[1:, 3:7] *= np.cumprod(np.where((q[1:, 3:7] * q[:-1, 3:7]).sum(axis=1) < 0.0, -1.0, 1.0))[:, None]
    return Recording(t, q, v, tau, wheel_momentum)


def _check_times(t: FloatArray) -> None:
    """Check that there are at least three samples, at times that increase without a gap."""
    if len(t) < 3:
        raise InvalidValue("recording t", t, "must have at least three samples")
    steps = np.diff(t)
    if not (steps > 0.0).all():
        k = int(np.argmin(steps))
        text = f"must increase, but row {k + 1} follows {t[k]:.6g} s"
        raise InvalidValue("recording t", float(t[k + 1]), text)
    usual = float(np.percentile(steps, _USUAL))
    if (longest := float(steps.max())) > _GAP * usual:
        k = int(np.argmax(steps))
        text = f"has a gap from {t[k]:.6g} to {t[k + 1]:.6g} s, {longest / usual:.3g} times the usual step;"
        raise InvalidValue("recording t", float(longest), f"{text} identify from the rows on one side of it")


def _check_units(sms: SpaceManipulator, recording: Recording) -> None:
    """Check that quaternions have unit length, and that joint positions and rates are not in degrees."""
    q, v = recording.q, recording.v
    lengths = np.linalg.norm(q[:, 3:7], axis=1)
    if (wrong := np.abs(lengths - 1.0) > 1e-3).any():
        k = int(np.argmax(wrong))
        text = f"must be a unit quaternion (x, y, z, w) in every row, but row {k} has length {lengths[k]:.6g}"
        raise InvalidValue("recording q[:, 3:7]", q[k, 3:7], text)
    limits = sms.limits
    for i, name in enumerate(sms.joint_names):
        if not sms.layout.turns[i]:
            continue
        most, farthest = float(np.abs(v[:, 6 + i]).max()), float(np.abs(q[:, sms.layout.index[i]]).max())
        bound = max(abs(limits.lower[i]), abs(limits.upper[i]))
        if farthest > _FARTHEST * (1.0 + bound) and not sms.layout.continuous[i]:
            text = f"has positions of joint '{name}' far beyond {bound:.4g} rad, as if in degrees;"
            raise InvalidValue("recording q", farthest, f"{text} np.radians converts them")
        if np.isfinite(limits.velocity[i]) and most > _FASTEST * limits.velocity[i]:
            text = f"of joint '{name}' is beyond ten times its limit of {limits.velocity[i]:.4g} rad/s: this"
            raise InvalidValue("recording v", most, f"{text} looks like degrees; np.radians converts them")


def _check_axes(sms: SpaceManipulator, recording: Recording, base_velocity: str) -> None:
    """Check that positions and velocities do not agree much better in other axes or quaternion order."""
    q = recording.q
    order = np.column_stack([q[:, :3], q[:, [4, 5, 6, 3]], q[:, 7:]])
    swapped = replace(recording, q=order)
    off = {axes: _disagreement(sms, _in_root_axes(recording, axes)) for axes in BASE_VELOCITIES}
    in_other_order = {axes: _disagreement(sms, _in_root_axes(swapped, axes)) for axes in BASE_VELOCITIES}
    least = _ALTERNATIVE * off[base_velocity]
    if least <= 1.0:
        return
    remedies: list[str] = []
    if min(in_other_order.values()) < min(least, *off.values()):
        off = in_other_order
        remedies.append("reorder the quaternions (w, x, y, z): q[:, 3:7] = q[:, [4, 5, 6, 3]]")
    best = min(off, key=lambda axes: off[axes])
    if off[best] > least:
        return
    if best != base_velocity:
        remedies.append(f'set base_velocity="{best}", {BASE_VELOCITIES[best]}')
    stated = f'base_velocity="{base_velocity}" and quaternions (x, y, z, w)'
    text = f"does not agree with the base's poses in q for {stated}; {' and '.join(remedies)}"
    raise InvalidValue("recording v", base_velocity, text)


def _disagreement(sms: SpaceManipulator, recording: Recording) -> float:
    """Return the RMS difference between changes of the base's pose and integrated velocities.

    Differences are divided by the expected differences, which are from noise and 0.1 % of the largest change.
    """
    moved, integrated, noise = (x[..., :6] for x in _windows(sms, recording))
    expected = _NOISE * noise + 1e-3 * np.abs(moved).max(axis=0) + 1e-9
    return float(np.sqrt(np.nanmean(((moved - integrated) / expected) ** 2)))


def _check_agreement(sms: SpaceManipulator, recording: Recording) -> None:
    """Check that positions and integrated velocities agree, channel by channel."""
    t, names = recording.t, _channels(sms)
    turns = [*[False] * 3, *[True] * 3, *sms.layout.turns]
    moved, integrated, noise = _windows(sms, recording)
    for c, name in enumerate(names):
        D, size = moved[:, c], float(np.sqrt(np.mean(moved[:, c] ** 2)))
        expected = integrated[:, c]
        other = float(np.sqrt(np.mean(expected**2)))
        if not max(size, other) >= _NOISE * noise[c] + 1e-9:  # also true for NaN (not measured)
            continue
        if (window := _frozen(D, expected, noise[c])) is not None:
            kinds = ("position", "velocity") if not D[window] else ("velocity", "position")
            start, end = _spans(recording.q)[window]
            text = f"has a frozen {kinds[0]} of {name} from {t[start]:.4g} to {t[end]:.4g} s, while its"
            raise InvalidValue(
                "recording",
                (float(D[window]), float(expected[window])),
                f"{text} {kinds[1]} changes; check the sensor",
            )
        scale = float(expected @ D) / max(float(expected @ expected), 1e-300)
        for factor, text in ((_DEGREES, "positions"), (1.0 / _DEGREES, "velocities")):
            if turns[c] and 0.8 < scale / factor < 1.25:
                problem = f"has {text} of {name} in degrees, judging by the ratio of changes in q to"
                raise InvalidValue("recording", scale, f"{problem} integrals of v; np.radians converts them")
        off = float(np.sqrt(np.mean((D - expected) ** 2)))
        if off > _AGREES * max(size, other) + _NOISE * noise[c]:
            problem = f"has positions and integrated velocities of {name} that differ by"
            length = float(t[-1] - t[0]) / len(D)
            problem += f" {100.0 * off / max(size, other):.0f} % over windows of {length:.3g} s;"
            if c < 6:
                problem += " the root's velocity must be [linear; angular] in the axes of `base_velocity`,"
                problem += " and its quaternion (x, y, z, w);"
            raise InvalidValue("recording", scale, f"{problem} check units, axes and order")


def _check_size(sms: SpaceManipulator, recording: Recording) -> None:
    """Raise `InvalidValue` if the base's linear velocity is zero or in millimetres per second.

    The velocity is compared with that of the model at zero momentum.
    """
    rows = np.unique(np.linspace(0, len(recording.t) - 1, _SOME).astype(int))
    q, v = recording.q[rows], recording.v[rows]
    q[:, :3] = 0.0
    if np.isnan(v[:, :3]).any():
        return
    modelled = v.copy()
    modelled[:, :3] = [sms.velocity(a, b[6:])[:3] for a, b in zip(q, v, strict=True)]
    velocities = (_inertial_velocity(replace(recording, q=q, v=x)) for x in (v, modelled))
    measured, expected = (x - x.mean(axis=0) for x in velocities)
    size = float(np.sum(expected**2))
    if size > 0.0 and not v[:, :3].any():
        text = "has no linear velocity of the base, which moves with the arm; if it is not measured, set"
        raise InvalidValue("recording v", 0.0, f"{text} v[:, :3] = np.nan")
    ratio = float(np.sum(measured * expected)) / max(size, 1e-300)
    if 1e3 / _MILLI < ratio < 1e3 * _MILLI:
        text = "has velocities of the base in mm/s, judging by the momentum; multiply them by 1e-3, and also"
        raise InvalidValue("recording v", ratio, f"{text} positions in millimetres")


def _frozen(D: FloatArray, expected: FloatArray, noise: float) -> int | None:
    """Return the index of a window in which only one of position and velocity changes, or None."""
    least = 4.0 * noise + 1e-3 * float(np.abs(np.concatenate([D, expected])).max()) + 1e-12
    still = ((D == 0.0) & (np.abs(expected) > least)) | ((expected == 0.0) & (np.abs(D) > least))
    return int(np.argmax(still)) if still.any() else None


def _channels(sms: SpaceManipulator) -> list[str]:
    axes = "xyz"
    base = [f"the base along {axis}" for axis in axes] + [f"the base about {axis}" for axis in axes]
    return [*base, *(f"joint '{name}'" for name in sms.joint_names)]


def _spans(q: FloatArray) -> list[tuple[int, int]]:
    """Return first and last rows of windows of q (N, nq), with 1 rad of base rotation on average at most."""
    turned = float(np.linalg.norm(np.diff(q[:, 3:7], axis=0), axis=1).sum()) * 2.0
    count = min(max(_WINDOWS, math.ceil(turned / _TURN)), len(q) - 1)
    edges = np.unique(np.linspace(0, len(q) - 1, count + 1).astype(int))
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _windows(sms: SpaceManipulator, recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return displacements (K, 6 + n) in K windows, by positions and by velocities, and noise (6 + n,).

    Displacements of the base are in the root's axes at the start of each window. A velocity is treated as
    frozen, with zero displacement, if it is bitwise constant over a window of at least four steps but changes
    in more than half of the recording's steps.
    """
    t, q, v = recording.t, recording.q, recording.v
    R, layout = rotations(q[:, 3:7].T), sms.layout
    first, second = q[:, layout.index], q[:, layout.index + layout.continuous]
    joints = np.where(layout.continuous, np.arctan2(second, first), first)
    joints = np.where(layout.continuous, np.unwrap(joints, axis=0), joints)
    world = np.column_stack([_inertial_velocity(recording), v[:, 3:]])
    steps = np.diff(t)[:, None]
    gained = 0.5 * (world[1:] + world[:-1]) * steps
    moved, integrated = [], []
    for a, b in _spans(q):
        turn = np.einsum("ji,jkn->ikn", R[:, :, a], R[:, :, a : b + 1])
        shift = R[:, :, a].T @ (q[b, :3] - q[a, :3])
        rotation = log3(turn[:, :, -1:])[:, 0]
        if np.array_equal(q[a, 3:7], q[b, 3:7]):
            rotation = np.zeros(3)
        if np.array_equal(q[a, :3], q[b, :3]):
            shift = np.zeros(3)
        moved.append(np.concatenate([shift, rotation, joints[b] - joints[a]]))
        total = gained[a:b].sum(axis=0)
        total[:3] = R[:, :, a].T @ total[:3]
        spin = apply(turn, v[a : b + 1, 3:6].T).T  # axes at the start of the window
        total[3:6] = (0.5 * (spin[1:] + spin[:-1]) * steps[a:b]).sum(axis=0)
        still = (v[a : b + 1] == v[a]).all(axis=0) & (b - a >= 4)
        total[still & _varies(v)] = 0.0
        integrated.append(total)
    position = np.column_stack([q[:, :3], 2.0 * q[:, 3:6], joints])
    count = max(float(np.diff(_spans(q)).mean()), 1.0)
    noise = np.hypot(np.sqrt(2.0) * noise_of(t, position), noise_of(t, v) * steps.mean() * np.sqrt(count))
    return np.array(moved), np.array(integrated), noise


def _varies(v: FloatArray) -> Any:
    """Return a mask of the velocities that change in more than half of the steps."""
    return (np.diff(v, axis=0) != 0.0).mean(axis=0) > 0.5
