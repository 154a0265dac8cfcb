"""Limits: what must hold."""
