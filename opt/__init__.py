"""Coupling-informed planning: the per-step quadratic programme, and trajectories made of its steps."""

from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.cost import ideal_cosine, soft_assistance, step_cost
from ffsms_pin.opt.many import plan_each, plan_many
from ffsms_pin.opt.plan import METHODS, plan
from ffsms_pin.opt.replanning import Replanning
from ffsms_pin.opt.step.result import Step
from ffsms_pin.opt.step_planner import StepPlanner, StepWeights
from ffsms_pin.opt.step_qp import StepProblem
from ffsms_pin.opt.trajectory import Trajectory

__all__ = [
    "METHODS",
    "BaseLimits",
    "Replanning",
    "Step",
    "StepPlanner",
    "StepProblem",
    "StepWeights",
    "Trajectory",
    "ideal_cosine",
    "plan",
    "plan_each",
    "plan_many",
    "soft_assistance",
    "step_cost",
]
