"""The whole motion at once: see docs/horizon.md."""

from ffsms_pin.opt.horizon.search import SearchOptions
from ffsms_pin.opt.horizon.solve import shortest, solve

__all__ = ["SearchOptions", "shortest", "solve"]
