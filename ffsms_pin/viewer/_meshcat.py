"""Imports Meshcat before anything else of the viewer does, without the warning that it sets off."""

import warnings

with warnings.catch_warnings():
    # Meshcat 0.3.2 imports a module of pyzmq that says it is deprecated, and does not use it.
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat

__all__ = ["meshcat"]
