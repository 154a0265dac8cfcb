"""Dynamic coupling between arm and base: the decomposition of C_bm and the paper's metrics."""

from ffsms_pin.coupling.metrics import cosine, cosine_of_triples, normalised_entropy
from ffsms_pin.coupling.svd import Coupling, decompose, reaction_null_space, scaled

__all__ = [
    "Coupling",
    "cosine",
    "cosine_of_triples",
    "decompose",
    "normalised_entropy",
    "reaction_null_space",
    "scaled",
]
