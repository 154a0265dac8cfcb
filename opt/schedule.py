"""How fast to go: a speed that brings the end effector to the target at the deadline (const8)."""

from __future__ import annotations

__all__ = ["ARRIVAL_POWER", "reference_speed"]

# The distance left shrinks as (time left)^p. With p = 2.5 the speed and the deceleration end at zero, the
# speed at the start is only 2.5 times the mean, and at 0.9 T, where const8 begins, 0.3 % of the way is left.
ARRIVAL_POWER = 2.5

# The schedule ends this many steps after the deadline. A stopped end effector has no direction, so
# cos(theta_a) would be undefined at the last step, and the paper's cost would charge for it. What is left of
# the speed there is some 1e-5 m/s.
AFTER = 2.0


def reference_speed(path_left: float, speed: float, time_left: float, dt: float) -> float:
    """End-effector speed [m/s] at the end of the next step.

    Parameters
    ----------
    path_left : float
        Length of the way to the target, at the step's start [m].
    speed : float
        Speed at the step's start [m/s].
    time_left : float
        Time from the step's start to the deadline [s].
    dt : float
        Step [s].
    """
    # speed_next = p (path left at the step's end) / (time left at the step's end), solved for speed_next.
    left_after = max(time_left - dt, 0.0) + AFTER * dt
    way = max(path_left - 0.5 * dt * speed, 0.0)
    return ARRIVAL_POWER * way / (left_after + 0.5 * dt * ARRIVAL_POWER)
