"""The public names of the package, for type checkers and for the lazy imports of `__init__.py`."""

from . import small_game_v0 as small_game_v0
from .agents import TableAgent as TableAgent
from .enumeration import enumerate_game as enumerate_game
from .env import SmallGameEnv as SmallGameEnv
from .env import SmallGameVectorEnv as SmallGameVectorEnv
from .game import Game as Game
from .game import ParallelGame as ParallelGame
from .mixing import mixed_share as mixed_share
from .named import load_game as load_game
from .simulator import GameSimulator as GameSimulator
from .simulator import GameTask as GameTask
from .small_game import SmallGame as SmallGame
from .small_game_v0 import SmallGameParallelEnv as SmallGameParallelEnv
from .solve import SmallEquilibrium as SmallEquilibrium
from .solve import SmallResponse as SmallResponse
from .solve import equilibrium as equilibrium
from .solve import nash_conv as nash_conv
from .solve import respond as respond
from .solve import returns_of as returns_of
from .tasks import game_of_sides as game_of_sides
from .tasks import game_of_task as game_of_task
from .tasks import states_of_games as states_of_games
