"""Limits: conditions that a motion must satisfy."""
