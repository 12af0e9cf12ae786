"""The names of the package: for type checkers, and for `__init__.py`, which imports them lazily."""

from .runs.opponents import load_policy as load_policy
