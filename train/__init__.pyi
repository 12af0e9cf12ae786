"""The names of the package: for type checkers, and for `__init__.py`, which imports them lazily."""

from .kinds import open_run as open_run
from .kinds import start as start
from .runs.export import export_policy as export_policy
from .runs.interruption import Stopped as Stopped
from .runs.opponents import load_policy as load_policy
from .runs.parts import settings_of as settings_of
from .tracker import Tracker as Tracker
