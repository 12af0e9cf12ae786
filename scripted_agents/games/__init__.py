"""Small games of any kind, enumerated and solved exactly.

Write a `Game` (or take a PettingZoo environment as a `ParallelGame`), list its states with
`enumerate_game`, and ask for `returns_of`, `respond`, `nash_conv` and `equilibrium`.
"""

from scripted_agents.games import small_game_v0 as small_game_v0
from scripted_agents.games.agents import TableAgent as TableAgent
from scripted_agents.games.enumeration import enumerate_game as enumerate_game
from scripted_agents.games.env import SmallGameEnv as SmallGameEnv
from scripted_agents.games.env import SmallGameVectorEnv as SmallGameVectorEnv
from scripted_agents.games.game import Game as Game
from scripted_agents.games.game import ParallelGame as ParallelGame
from scripted_agents.games.mixing import mixed_share as mixed_share
from scripted_agents.games.named import load_game as load_game
from scripted_agents.games.simulator import GameSimulator as GameSimulator
from scripted_agents.games.simulator import GameTask as GameTask
from scripted_agents.games.small_game import SmallGame as SmallGame
from scripted_agents.games.small_game_v0 import SmallGameParallelEnv as SmallGameParallelEnv
from scripted_agents.games.solve import SmallEquilibrium as SmallEquilibrium
from scripted_agents.games.solve import SmallResponse as SmallResponse
from scripted_agents.games.solve import equilibrium as equilibrium
from scripted_agents.games.solve import nash_conv as nash_conv
from scripted_agents.games.solve import respond as respond
from scripted_agents.games.solve import returns_of as returns_of
from scripted_agents.games.tasks import game_of_sides as game_of_sides
from scripted_agents.games.tasks import game_of_task as game_of_task
from scripted_agents.games.tasks import states_of_games as states_of_games
