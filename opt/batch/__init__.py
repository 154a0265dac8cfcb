"""Motions of the arm at stacks of configurations: their quantities by the compiled kernel, and residuals."""

from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import JointResidual, Residual, Residuals

__all__ = ["JointResidual", "Motions", "Residual", "Residuals"]
