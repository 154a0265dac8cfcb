"""Animated scenes of planned and simulated motions, on Pinocchio's Meshcat visualizer."""

import importlib
import warnings

from ffsms_pin.extras import require

require("view", "the viewer")
with warnings.catch_warnings():
    # Meshcat 0.3.2 imports a module of pyzmq that says it is deprecated, and does not use it.
    warnings.simplefilter("ignore", DeprecationWarning)
    importlib.import_module("meshcat")

# ruff: noqa: E402  # the check comes first, so that its message is the one that is seen
from ffsms_pin.viewer.frames import CAMERAS
from ffsms_pin.viewer.live import LiveView
from ffsms_pin.viewer.opened import View, view, view_capture
from ffsms_pin.viewer.page import LAYERS

__all__ = ["CAMERAS", "LAYERS", "LiveView", "View", "view", "view_capture"]
