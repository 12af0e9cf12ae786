"""The names of the package: for type checkers, and for `__init__.py`, which imports them lazily."""

from . import chase_v0 as chase_v0
from . import heist_v0 as heist_v0
from . import maze_v0 as maze_v0
from . import race_v0 as race_v0
from . import reacher_v0 as reacher_v0
from .evaluation import Evaluation as Evaluation
from .evaluation import evaluate as evaluate
from .maps import Scenario as Scenario
from .maps import cell_at as cell_at
from .maps import read_grid as read_grid
from .maps import read_map as read_map
from .maps import read_scenarios as read_scenarios
from .maze import Maze as Maze
from .maze import library_names as library_names
from .maze import load_maze as load_maze
from .maze_generation import generate_maze as generate_maze
from .parts import allow as allow
from .policy import GameView as GameView
from .policy import Memory as Memory
from .policy import MemoryPolicy as MemoryPolicy
from .policy import Policy as Policy
from .reacher.simulator import ReacherSimulator as ReacherSimulator
from .reacher.single_agent import ReacherEnv as ReacherEnv
from .reacher.single_agent import ReacherVectorEnv as ReacherVectorEnv
from .reacher.task import ReacherTask as ReacherTask
from .recorder import Recorder as Recorder
from .replay import Replay as Replay
from .simulator import Simulator as Simulator
from .single_agent import SingleAgentEnv as SingleAgentEnv
from .single_agent import SingleAgentVectorEnv as SingleAgentVectorEnv
from .suites import load_suite as load_suite
from .suites import suite_difficulty as suite_difficulty
from .suites import suite_names as suite_names
from .task import Rewards as Rewards
from .task import Task as Task
from .task import make_task as make_task

__version__: str
