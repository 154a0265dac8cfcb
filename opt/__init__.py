"""Coupling-informed planning: problems made of terms and limits, and solvers that only stack them."""

from ffsms_pin.geometry.obstacle import Obstacle
from ffsms_pin.opt.goals.goal import Goal, Moving, Pose, Position
from ffsms_pin.opt.goals.meet import Corridor, Meet
from ffsms_pin.opt.goals.near import Also, Via
from ffsms_pin.opt.horizon.search import SearchOptions
from ffsms_pin.opt.horizon.solve import shortest, solve
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows, Violation
from ffsms_pin.opt.limits.motion import AlphaBox, BaseLimits, JointLimits
from ffsms_pin.opt.limits.motors import TorqueLimits, WheelLimits
from ffsms_pin.opt.motion import Feature, Features, Motions
from ffsms_pin.opt.parts.check import check
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.opt.parts.term import Term
from ffsms_pin.opt.plans import METHODS, plan, plan_many
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.replanning import Replanning
from ffsms_pin.opt.replan.step_planner import StepPlanner
from ffsms_pin.opt.step.programme import StepProblem, StepWeights
from ffsms_pin.opt.step.stepper import Step
from ffsms_pin.opt.terms import (
    BaseTurn,
    Coupling,
    Effort,
    Propellant,
    Smooth,
    WheelEnergy,
    WheelMomentum,
    ideal_cosine,
    soft_assistance,
    step_cost,
)
from ffsms_pin.opt.trajectory import Trajectory

__all__ = [
    "METHODS",
    "UNBOUNDED",
    "AlphaBox",
    "Also",
    "BaseLimits",
    "BaseTurn",
    "Clearance",
    "Corridor",
    "Coupling",
    "Effort",
    "Feature",
    "Features",
    "Goal",
    "Inequality",
    "JointLimits",
    "Limit",
    "Meet",
    "Motions",
    "Moving",
    "Obstacle",
    "Pose",
    "Position",
    "Problem",
    "Propellant",
    "ReplanOptions",
    "Replanning",
    "Rows",
    "SearchOptions",
    "Smooth",
    "Step",
    "StepPlanner",
    "StepProblem",
    "StepWeights",
    "Term",
    "TorqueLimits",
    "Trajectory",
    "Via",
    "Violation",
    "WheelEnergy",
    "WheelLimits",
    "WheelMomentum",
    "check",
    "ideal_cosine",
    "plan",
    "plan_many",
    "shortest",
    "soft_assistance",
    "solve",
    "step_cost",
]
