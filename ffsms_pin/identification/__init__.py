"""The identification of masses, centres of mass and inertias from the robot's own motion."""

from ffsms_pin.identification.comparison import compared
from ffsms_pin.identification.excitation import Excitation
from ffsms_pin.identification.exciting import exciting_motion
from ffsms_pin.identification.identifier import Identifier
from ffsms_pin.identification.identify import identify
from ffsms_pin.identification.result import BodyEstimate, Direction, Identification

__all__ = [
    "BodyEstimate",
    "Direction",
    "Excitation",
    "Identification",
    "Identifier",
    "compared",
    "exciting_motion",
    "identify",
]
