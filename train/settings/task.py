"""Settings of tasks and opponents by name: games in mazes, the arm, and small games."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pursuit.mazes.suite_files import PREFIX, is_suite
from pursuit.observations.custom import check_observation
from pursuit.plugins import OPENSPIEL
from pursuit.reacher.observations import ENCODINGS as ARM_ENCODINGS
from pursuit.reacher.task import ReacherTask
from pursuit.tasks.options import (
    CAPTURE_CHECKS,
    CAPTURES,
    COLLISIONS,
    check_exits,
    check_slip,
    slip_text,
)
from pursuit.tasks.rewards import check_rewards, rewards_text
from pursuit.tasks.task import TASK_NAMES
from pursuit.tasks.visibility import (
    agent_choice_text,
    check_agent_choice,
    check_view_radius,
    view_radius_text,
)
from pursuit.validation import Rule, check, choice, one_of, rule
from scripted_agents.environments import agent_name
from scripted_agents.games.named import split_name
from scripted_agents.games.simulator import ENCODINGS as GAME_ENCODINGS
from train.settings.checks import RANDOM_MOVES, Settings

REACHER, GAME = "reacher", "game"
AGENT = Rule(lambda _, name: agent_name(name))
"""An agent by name; former names are replaced."""
MOST_STEPS = 100_000
_STEPS = rule(
    lambda value: value <= MOST_STEPS,
    f"give at most {MOST_STEPS}, as evaluations play every episode to this limit if no agent is "
    "caught",
)
Steps = Annotated[int, _STEPS]


def _text_of_rewards(name: str, given: object) -> str:
    text = rewards_text(given)
    if text != "default":
        check_rewards(name, text)
    return text


def _as_text(checked: Callable[[str, Any], Any], text: Callable[[Any], str | None]) -> Rule:
    """The rule of a field that is stored as text, so that equal settings are equal."""
    return Rule(lambda name, given: text(checked(name, given)), other_types=True)


RewardsText = Annotated[str, Rule(_text_of_rewards, other_types=True)]
RadiusText = Annotated[str | None, _as_text(check_view_radius, view_radius_text)]
SlipText = Annotated[str, _as_text(check_slip, slip_text)]
ExitsText = Annotated[str | None, _as_text(check_exits, lambda cells: ",".join(map(str, cells)))]
AgentsText = Annotated[str, _as_text(check_agent_choice, agent_choice_text)]


@dataclass(frozen=True)
class TaskSettings(Settings):
    """A game in mazes, and the opponents in it."""

    OBSERVATION: ClassVar[str] = "index"
    game: ClassVar[None] = None
    """The name of a small game: none."""
    ADDED: ClassVar[tuple[str, ...]] = (
        *("capture", "n_catch", "capture_check", "exits", "num_exits", "collisions", "slip"),
    )

    task: str = "chase"
    """chase, maze, race, heist, escape, reacher (an arm; for its options see --task reacher --help)
    or game (a small game; see --game NAME --help)."""
    role: str = "auto"
    """Learning agent: chaser, evader or runner, or one agent such as chaser_1. auto: the first."""
    maze: str = "5x5"
    """A maze of the library (2x2 ... 9x9, 15x15, also with -tree and -open), a maze file, or a
    suite of mazes such as suite:7x7-train or suite:7x7-train/0-99."""
    num_chasers: int | None = None
    """Number of chasers. None: that of the task."""
    num_evaders: int | None = None
    """Number of evaders. None: that of the task."""
    num_runners: int | None = None
    """Number of runners. None: that of the task."""
    num_goals: int | None = None
    """Number of goals. None: that of the task."""
    max_steps: Steps = 200
    """Steps after which an episode is truncated, at most 100,000."""
    stay_action: bool = False
    """Add an action, the last one: stay."""
    move_order: str = "simultaneous"
    """Order of moves: simultaneous, chasers_first, or turns (each side sees the other's move; needs
    the stay action)."""
    min_start_distance: int = 1
    """Minimum distance in steps between chasers and evaders at the start, in tasks with both."""
    capture: Annotated[str, choice(*CAPTURES)] = "cell"
    """Where chasers capture an evader: cell (in its cell), adjacent (one move away), surround (on
    all cells next to it)."""
    n_catch: int = 1
    """Number of chasers that a capture needs (cell, adjacent)."""
    capture_check: Annotated[str, choice(*CAPTURE_CHECKS)] = "each_move"
    """each_move, or after_chasers: no captures after the evaders' moves, if chasers move first."""
    exits: ExitsText = None
    """Cells of exits, such as 3,17. None: the marks E of the maze."""
    num_exits: int = 0
    """Number of exits that are drawn at every reset, instead of fixed ones."""
    collisions: Annotated[str, choice(*COLLISIONS)] = "share"
    """share: agents can share cells; block: those of one role cannot, nor can chasers and evaders
    unless captures are in the cell."""
    slip: SlipText = "0"
    """Probability that a move becomes a random one: 0.1, or by role or agent, as evader=0.1."""
    rewards: RewardsText = "default"
    """default, goal, completion, distance, zero_sum, win_loss, pursuit_v5 or pursuit_v5_local
    (those of PettingZoo with shared rewards, and without); or coefficients such as
    step=-0.1,capture=2 or chaser.step=-0.1,evader.capture=-2 (of step, capture, goal, distance,
    on_completion, per_evader, escape, touch); or package.module:Name of a user-defined function."""
    view_radius: RadiusText = None
    """Observation radius in path steps: a number for all agents, or by role or agent, such as
    chaser=2,evader_0=3. None: unlimited. The scripted astar, random and equilibrium ignore it."""
    line_of_sight: AgentsText = ""
    """Agents that see along rows and columns only, up to the next wall: all (or no value), or roles
    and agents such as chaser,evader_0."""
    unknown_maze: AgentsText = ""
    """Agents that know only the visible part of the maze: all (or no value), or roles/agents."""
    opponent_epsilon: Annotated[float, RANDOM_MOVES] = 0.2
    """Probability of a random move of the scripted opponents, in [0, 1]."""
    opponent: Annotated[str | None, AGENT] = None
    """None: A*. Otherwise random, uniform (all actions), equilibrium, searching (chasers also
    sweeping, belief; these three respect the limited view), the folder of a run, a saved
    Stable-Baselines3 model (.zip), or package.module:Name of a user-defined policy."""
    opponent_policy: Annotated[str, choice("sampled", "greedy")] = "sampled"
    """Policy of a learned opponent: sampled (from its distribution), or greedy (the most probable
    action)."""
    opponent_observation: str | None = None
    """Observation of an opponent saved by model.save() of Stable-Baselines3, such as one_hot."""
    start: str = "random"
    """Starts: random, or marks (S and G of the maze; fixed goals)."""
    mask_bumps: bool = False
    """Mask the learner's moves into walls, in training and evaluation. Without the stay action such
    moves are the only way to wait, which optimal chasers and evaders do."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.task != REACHER,
            f"task={self.task!r} is not a game in mazes; use {', '.join(TASK_NAMES)} here, and the "
            "arm in `pursuit train`, `baseline`, `render` or a sweep (ReacherSettings in Python)",
        )
        one_of("task", self.task, (*TASK_NAMES, REACHER, GAME))

    @property
    def agent(self) -> str:
        """The learning agent or role."""
        return learning_agent(self.task, self.role)

    @property
    def label(self) -> str:
        """The beginning of the name of a run's folder."""
        maze = self.maze.removeprefix(PREFIX).replace("/", "-")
        return f"{self.task}-{self.agent}-{maze if is_suite(self.maze) else Path(self.maze).stem}"

    def check_observation(self, name: str) -> None:
        """ValueError unless this observation exists."""
        check_observation(name)


def learning_agent(task: str, role: str) -> str:
    """The given role; for "auto" the first role of the task."""
    if role != "auto":
        return role
    return "runner" if task in ("maze", "race") else "chaser"


@dataclass(frozen=True)
class ReacherSettings(Settings):
    """An arm that moves its tip to a target in as few steps as possible."""

    OBSERVATION: ClassVar[str] = "positions"
    game: ClassVar[None] = None
    """The name of a small game: none."""

    task: Annotated[str, choice(REACHER)] = REACHER
    """reacher (for the options of games in mazes see --task chase --help)."""
    joints: int = 2
    """Number of joints, 1 to 8; links have length 1."""
    start: str = "kept"
    """Initial pose of an episode: kept (from the last episode), random, or fixed (straight)."""
    hold: int = 1
    """Consecutive steps that the tip must stay within the tolerance."""
    tolerance: float = 0.2
    """Distance from the target within which it is reached."""
    max_steps: Steps = 400
    """Steps after which an episode is truncated, at most 100,000."""
    max_turn: float = 0.1
    """Largest turn of a joint in one step, in radians."""
    effort: float = 0.01
    """Cost of turning one joint by max_turn."""
    discrete_actions: bool = False
    """Discrete actions: every joint turns by max_turn in one of both directions, or stays."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.build()

    @property
    def label(self) -> str:
        """The beginning of the name of a run's folder."""
        return f"{self.task}-{self.joints}"

    def build(self) -> ReacherTask:
        """The task itself; ValueError for settings that it does not allow."""
        return ReacherTask(**{name: own for name, own in vars(self).items() if name != "task"})

    def check_observation(self, name: str) -> None:
        """ValueError unless this observation exists."""
        one_of("observation", name, ARM_ENCODINGS)


@dataclass(frozen=True)
class SmallGameSettings(Settings):
    """A small game, whose states are all enumerated, and the policies of the other players."""

    OBSERVATION: ClassVar[str] = "index"

    task: Annotated[str, choice(GAME)] = GAME
    """game (for the options of games in mazes see --task chase --help)."""
    game: str = ""
    """Name of the game: a shipped one such as soccer or goofspiel(cards=4), openspiel:NAME(...), or
    package.module:Name(size=4) of a class or function that returns a Game."""
    player: str = "auto"
    """Learning player, by name. auto: the first."""
    max_steps: Steps = 200
    """Steps after which an episode is truncated, at most 100,000."""
    opponent: Annotated[str, AGENT] = "uniform"
    """Policy of the other players: uniform, equilibrium (of a zero-sum game of two), the folder of
    a run, or package.module:Name of a function of a state that returns probabilities."""
    opponent_epsilon: Annotated[float, RANDOM_MOVES] = 0.0
    """Probability of a uniformly random action of the opponents, in [0, 1]."""
    opponent_policy: Annotated[str, choice("sampled", "greedy")] = "sampled"
    """Policy of a learned opponent: sampled (from its distribution), or greedy (the most probable
    action)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        split_name(self.game)

    @property
    def agent(self) -> str:
        """The learning player."""
        return self.player

    @property
    def label(self) -> str:
        """The beginning of the name of a run's folder."""
        name = "-".join(re.findall(r"[\w.]+", self.game.removeprefix(OPENSPIEL)))
        return name if self.player == "auto" else f"{name}-{self.player}"

    def check_observation(self, name: str) -> None:
        """ValueError unless this observation exists."""
        one_of("observation", name, GAME_ENCODINGS)


AnyTask = TaskSettings | ReacherSettings | SmallGameSettings


def in_maze(task: AnyTask, what: str) -> TaskSettings:
    """`task` if it is a game in mazes, otherwise ValueError; `what` starts the message."""
    if not isinstance(task, TaskSettings):
        raise ValueError(f"{what}: not for task {task.task!r}; use a game in mazes")
    return task


def task_form(given: Mapping[str, object]) -> type[AnyTask]:
    """The settings class of a task, by the settings "task" and "game"; `TaskSettings` for an
    unknown name, which it refuses."""
    if given.get("game") is not None or given.get("task") == GAME:
        return SmallGameSettings
    return ReacherSettings if given.get("task") == REACHER else TaskSettings
