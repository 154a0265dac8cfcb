"""Clearances: how far the robot is from itself and from obstacles, and what keeps it clear."""

from ffsms_pin.opt.limits.clearance.clearance import Clearance
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle

__all__ = ["Clearance", "Obstacle"]
