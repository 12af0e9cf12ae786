"""The version, apart from the face of the package, so that any file may know it."""

__version__ = "0.2.0.dev0"
