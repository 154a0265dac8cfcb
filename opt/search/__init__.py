"""The whole motion at once: see docs/horizon.md."""

from ffsms_pin.opt.search.search import SearchOptions, shortest, solve

__all__ = ["SearchOptions", "shortest", "solve"]
