"""Obstacles: what they are, how far the arm is from them, and what keeps it clear of them."""

from ffsms_pin.opt.limits.obstacles.obstacle import Obstacle

__all__ = ["Obstacle"]
