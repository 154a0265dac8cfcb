"""Goals: where the end effector should be at the deadline, and how it should arrive."""

from ffsms_pin.opt.goals.goal import (
    ORIENTATION_REACH,
    REACH,
    TOLERANCE,
    Goal,
    Moving,
    Place,
    Pose,
    Position,
    Shifted,
    as_goal,
    rotation_matrix,
)
from ffsms_pin.opt.goals.meet import Meet

__all__ = [
    "ORIENTATION_REACH",
    "REACH",
    "TOLERANCE",
    "Goal",
    "Meet",
    "Moving",
    "Place",
    "Pose",
    "Position",
    "Shifted",
    "as_goal",
    "rotation_matrix",
]
