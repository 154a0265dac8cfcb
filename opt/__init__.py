"""The planning of motions: problems of cost terms and limits, and their solvers."""

from ffsms_pin.geometry.obstacle import Obstacle
from ffsms_pin.opt.check import check
from ffsms_pin.opt.costs import (
    BaseTurn,
    Coupling,
    Effort,
    Propellant,
    Smooth,
    Term,
    WheelEnergy,
    WheelMomentum,
    ideal_cosine,
    soft_assistance,
    step_cost,
)
from ffsms_pin.opt.derivatives import Variable, Variables
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows, Violation
from ffsms_pin.opt.goals.goal import Goal, Moving, Pose, Position
from ffsms_pin.opt.goals.meet import Meet
from ffsms_pin.opt.goals.named_curves import Circle, Helix, Line, RoundedSquare
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.goals.pose_constraints import Alignment, Corridor, FrameGoal, Waypoint
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.base_limits import BaseLimits
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.joint_limits import JointLimits
from ffsms_pin.opt.limits.limit import Inequality, Limit
from ffsms_pin.opt.limits.torque_limits import TorqueLimits
from ffsms_pin.opt.limits.wheel_limits import WheelLimits
from ffsms_pin.opt.plans import METHODS, plan, plan_many
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.learning import Learner
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.replanning import Replanning
from ffsms_pin.opt.replan.step_planner import StepPlanner
from ffsms_pin.opt.rollouts import Rollouts
from ffsms_pin.opt.search.search import SearchOptions, shortest, solve
from ffsms_pin.opt.step.stepper import Step, StepProblem, StepWeights
from ffsms_pin.opt.trajectory import Trajectory

# Earlier names.
Via = Waypoint
Also = FrameGoal

__all__ = [
    "METHODS",
    "UNBOUNDED",
    "Alignment",
    "AlphaBox",
    "BaseLimits",
    "BaseTurn",
    "Circle",
    "Clearance",
    "Corridor",
    "Coupling",
    "Effort",
    "FrameGoal",
    "Goal",
    "Helix",
    "Inequality",
    "JointLimits",
    "Learner",
    "Limit",
    "Line",
    "Meet",
    "Moving",
    "Obstacle",
    "Path",
    "Pose",
    "Position",
    "Problem",
    "Propellant",
    "ReplanOptions",
    "Replanning",
    "Rollouts",
    "RoundedSquare",
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
    "Variable",
    "Variables",
    "Violation",
    "Waypoint",
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
