"""The public names of the package, for type checkers and for the lazy imports of `__init__.py`."""

from . import chase_v0 as chase_v0
from . import heist_v0 as heist_v0
from . import maze_v0 as maze_v0
from . import race_v0 as race_v0
from . import reacher_v0 as reacher_v0
from .environments.single_agent import SingleAgentEnv as SingleAgentEnv
from .environments.single_agent import SingleAgentVectorEnv as SingleAgentVectorEnv
from .evaluation import Evaluation as Evaluation
from .evaluation import evaluate as evaluate
from .mazes.generation import generate_graph as generate_graph
from .mazes.generation import generate_maze as generate_maze
from .mazes.maze import Maze as Maze
from .mazes.maze import library_names as library_names
from .mazes.maze import load_maze as load_maze
from .mazes.suites import load_suite as load_suite
from .mazes.suites import suite_names as suite_names
from .plugins import allow as allow
from .reacher.simulator import ReacherSimulator as ReacherSimulator
from .reacher.single_agent import ReacherEnv as ReacherEnv
from .reacher.single_agent import ReacherVectorEnv as ReacherVectorEnv
from .reacher.task import ReacherTask as ReacherTask
from .replays.datasets import export_minari as export_minari
from .replays.recorder import Recorder as Recorder
from .replays.replay import Replay as Replay
from .simulator.policy import GameView as GameView
from .simulator.policy import Memory as Memory
from .simulator.policy import MemoryPolicy as MemoryPolicy
from .simulator.policy import Policy as Policy
from .simulator.simulator import Simulator as Simulator
from .tasks.task import Rewards as Rewards
from .tasks.task import Task as Task
from .tasks.task import make_task as make_task

__version__: str
