"""Optimisation of whole motions: see docs/planner.md."""

from ffsms_pin.opt.search.search import SearchOptions, shortest, solve

__all__ = ["SearchOptions", "shortest", "solve"]
