"""The optimisation of whole motions (docs/planner.md)."""

from ffsms_pin.opt.search.search import SearchOptions, shortest, solve

__all__ = ["SearchOptions", "shortest", "solve"]
