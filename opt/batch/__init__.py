"""The fast kernel: the arm at stacks of configurations, in numpy."""

from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import JointResidual, Residual, Residuals

__all__ = ["JointResidual", "Motions", "Residual", "Residuals"]
