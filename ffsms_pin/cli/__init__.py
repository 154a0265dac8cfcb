"""The command line `ffsms-pin`."""

from ffsms_pin.cli.main import main

__all__ = ["main"]
