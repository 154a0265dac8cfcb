"""Coupling-informed planning: problems made of terms and limits, and solvers that only stack them."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.opt.goals.goal import Goal as Goal, Moving as Moving, Pose as Pose, Position as Position
    from ffsms_pin.opt.goals.meet import Corridor as Corridor, Meet as Meet
    from ffsms_pin.opt.goals.near import Also as Also, Via as Via
    from ffsms_pin.opt.horizon.search import SearchOptions as SearchOptions
    from ffsms_pin.opt.horizon.solve import shortest as shortest, solve as solve
    from ffsms_pin.opt.limits.clearance.clearance import Clearance as Clearance
    from ffsms_pin.opt.limits.clearance.obstacle import Obstacle as Obstacle
    from ffsms_pin.opt.limits.limit import (
        UNBOUNDED as UNBOUNDED,
        Limit as Limit,
        Rows as Rows,
        Violation as Violation,
    )
    from ffsms_pin.opt.limits.motion import (
        AlphaBox as AlphaBox,
        BaseLimits as BaseLimits,
        JointLimits as JointLimits,
    )
    from ffsms_pin.opt.limits.motors import TorqueLimits as TorqueLimits, WheelLimits as WheelLimits
    from ffsms_pin.opt.motion import Feature as Feature, Features as Features, Motions as Motions
    from ffsms_pin.opt.parts.check import check as check
    from ffsms_pin.opt.parts.inequality import Inequality as Inequality
    from ffsms_pin.opt.parts.reading import JointResidual as JointResidual, Residual as Residual
    from ffsms_pin.opt.parts.term import Term as Term
    from ffsms_pin.opt.plans import (
        METHODS as METHODS,
        plan as plan,
        plan_each as plan_each,
        plan_many as plan_many,
    )
    from ffsms_pin.opt.problem import Problem as Problem
    from ffsms_pin.opt.replan.options import ReplanOptions as ReplanOptions
    from ffsms_pin.opt.replan.replanning import Replanning as Replanning
    from ffsms_pin.opt.replan.step_planner import StepPlanner as StepPlanner
    from ffsms_pin.opt.step.programme import StepProblem as StepProblem, StepWeights as StepWeights
    from ffsms_pin.opt.step.stepper import Step as Step
    from ffsms_pin.opt.terms import (
        BaseTurn as BaseTurn,
        Coupling as Coupling,
        Effort as Effort,
        Propellant as Propellant,
        Smooth as Smooth,
        WheelEnergy as WheelEnergy,
        WheelMomentum as WheelMomentum,
        ideal_cosine as ideal_cosine,
        soft_assistance as soft_assistance,
        step_cost as step_cost,
    )
    from ffsms_pin.opt.trajectory import Trajectory as Trajectory
else:
    __getattr__, __dir__, __all__ = later(__name__)
