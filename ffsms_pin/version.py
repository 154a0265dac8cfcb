"""The version of the library, apart from the package's own file so that any part can read it."""

__version__ = "0.1.0"
