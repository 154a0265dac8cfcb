"""The inspection and repair of URDF files."""

from ffsms_pin.inspection.faults import Change, Fault
from ffsms_pin.inspection.report import JointReport, LinkReport, Report, inspect, repair

__all__ = ["Change", "Fault", "JointReport", "LinkReport", "Report", "inspect", "repair"]
