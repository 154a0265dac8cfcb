"""The animated scenes of planned and simulated motions, as HTML pages with Meshcat's viewer."""

from ffsms_pin.errors import require

require("view", "the viewer")

# ruff: noqa: E402  # the check must run before the imports, so that its message is shown
from ffsms_pin.viewer.animation import View, view, view_capture
from ffsms_pin.viewer.frames import CAMERAS
from ffsms_pin.viewer.page import LAYERS

__all__ = ["CAMERAS", "LAYERS", "View", "view", "view_capture"]
