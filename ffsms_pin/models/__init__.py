"""Any arm on any satellite: mounting, and the satellites that load by name."""

from ffsms_pin.models.base import SatelliteBase
from ffsms_pin.models.loading import load, satellite_names
from ffsms_pin.models.mounting import mount

__all__ = ["SatelliteBase", "load", "mount", "satellite_names"]
