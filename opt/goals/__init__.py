"""Goals: where the end effector should be at the deadline, and how it should arrive."""

from ffsms_pin.opt.goals.goal import (
    ORIENTATION_REACH,
    REACH,
    Changed,
    Goal,
    Moving,
    Pose,
    Position,
    as_goal,
)
from ffsms_pin.opt.goals.meet import Corridor, Meet
from ffsms_pin.opt.goals.near import Also, Via
from ffsms_pin.opt.goals.place import Place

__all__ = [
    "ORIENTATION_REACH",
    "REACH",
    "Also",
    "Changed",
    "Corridor",
    "Goal",
    "Meet",
    "Moving",
    "Place",
    "Pose",
    "Position",
    "Via",
    "as_goal",
]
