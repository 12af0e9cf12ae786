"""Settings of tasks and opponents by name: games in mazes, the arm, and small games."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pursuit.mazes.suite_files import PREFIX, is_suite
from pursuit.observations.custom import check_observation, is_builtin
from pursuit.observations.observations import Encoder
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
from pursuit.tasks.rewards import (
    REWARDS,
    ROLES,
    check_rewards,
    is_coefficients,
    rewards_from_text,
    rewards_text,
)
from pursuit.tasks.task import TASK_NAMES, Task, make_task
from pursuit.tasks.visibility import (
    agent_choice_text,
    check_agent_choice,
    check_view_radius,
    view_radius_text,
)
from pursuit.validation import Rule, check, choice, one_of, rule
from scripted_agents.games.enumeration import names_of_players
from scripted_agents.games.named import game_named, load_game, split_name
from scripted_agents.games.simulator import ENCODINGS as GAME_ENCODINGS
from scripted_agents.games.simulator import GameTask
from scripted_agents.games.small_game import KEPT, longest_play
from scripted_agents.names import (
    AGENTS,
    EQUILIBRIUM,
    GAME_AGENTS,
    GAME_DISCOUNT,
    PLAYED_ROLES,
    agent_name,
    check_agent,
)
from train.settings.checks import RANDOM_MOVES
from train.settings.mazes import as_text, check_one_maze, maze_or_suite
from train.settings.profile import TaskProfile
from train.settings.task_form import FORMS, TaskForm

REACHER, GAME = "reacher", "game"
OPPONENT = ("opponent", "opponent_policy", "opponent_epsilon")
CAPTURING = ("move_order", "min_start_distance", "capture", "n_catch", "capture_check")
"""Settings of chasers and evaders together."""
DISCRETE = {"action_std": "the actions are discrete"}
OPPOSING_ROLES = ("chaser", "evader")
"""The roles that learn in self-play in mazes."""
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
class TaskSettings(TaskForm):
    """A game in mazes, and the opponents in it."""

    AGENT: ClassVar[str] = "role"
    POLICIES: ClassVar[tuple[str, ...]] = OPPONENT
    AGENTS: ClassVar[tuple[str, ...]] = AGENTS
    TASKS: ClassVar[tuple[str, ...]] = TASK_NAMES
    sides: ClassVar[tuple[str, ...]] = OPPOSING_ROLES
    IDENTITY: ClassVar[tuple[str, ...]] = ()
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
    sweeping, belief; these three respect the limited view; and gathering, a team that sees 7x7
    windows), the folder of a run, an exported policy (.onnx), a saved Stable-Baselines3 model
    (.zip), or package.module:Name of a user-defined policy."""
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
        """The learning agent or role; for "auto" the first role of the task."""
        return learning_agent(self.task, self.role)

    @property
    def label(self) -> str:
        """As of `TaskForm`."""
        maze = self.maze.removeprefix(PREFIX).replace("/", "-")
        return f"{self.task}-{self.agent}-{maze if is_suite(self.maze) else Path(self.maze).stem}"

    @property
    def game_label(self) -> str:
        """As of `TaskForm`: the maze."""
        return Path(self.maze).stem

    def build(self) -> Task:
        """The task, with its maze loaded; one object for equal settings.

        Raises:
            ValueError: no such maze, or settings that the task does not allow.
        """
        own = vars(self)
        # None, and the rewards "default", are those of the named task.
        changed = {
            each.name: own[each.name] for each in fields(Task) if own.get(each.name) is not None
        }
        if self.rewards == "default":
            del changed["rewards"]
        changed["maze"] = maze_or_suite(self.maze)
        if REWARDS.origin(self.rewards) is not None:  # the function of a name may change
            return make_task(self.task, **changed)
        return _built_once(self.task, **changed)

    def agent_in(self, task: Task) -> str:
        """As of `TaskForm`; also a role."""
        known = {*task.agent_names, *task.seat_roles}
        check(
            self.agent in known,
            f"role {self.agent!r} does not exist in task {self.task!r}; use one of "
            f"{', '.join(sorted(known))}",
        )
        return self.agent

    def hint(self) -> str:
        """As of `TaskForm`: the teammates that do not learn; runners compete, and have none."""
        task, role = self.build(), self.agent.split("_")[0]
        count = task.count(role)
        if count < 2 or task.num_runners:
            return ""
        rest = (
            f"the other {count - 1} play fixed policies" if count > 2 else "the other one is fixed"
        )
        return f"one of {count} {role}s learns, {rest}; to train all: --algorithm ippo"

    @classmethod
    def for_self_play(cls, given: Mapping[str, object]) -> Mapping[str, object]:
        """As of `TaskForm`: rewards of steps, or with exits of captures and escapes."""
        exits = given.get("task") == "escape" or {"exits", "num_exits"} & set(given)
        return {"rewards": "win_loss" if exits else "zero_sum"}

    def check_self_play(self, sides: Mapping[str, object], members: Sequence[str]) -> None:
        """As of `TaskForm`: chasers and evaders only, in one maze."""
        task = self.build()
        check_one_maze(task, "self-play")
        check(
            bool(task.num_chasers and task.num_evaders),
            f"task {task.name!r} has no chasers or no evaders; use chase or heist",
        )
        check(
            not task.num_goals or self.rewards == "zero_sum",
            f"rewards={self.rewards!r} with goals; use zero_sum: opponents are scored by steps, so "
            "chasers must be rewarded for short episodes",
        )
        check(
            not task.most_exits or (self.rewards != "zero_sum" and not task.num_goals),
            f"rewards={self.rewards!r}, num_goals={task.num_goals} with exits; use win_loss "
            "without goals: opponents are scored by captures and escapes, and zero_sum pays steps",
        )
        check(not task.num_runners, f"task {task.name!r} has runners; use chase or heist")
        for role, side in sides.items():
            for name in (
                side,
                *(name for name in members if role in PLAYED_ROLES.get(name, OPPOSING_ROLES)),
            ):
                if isinstance(name, str) and name in AGENTS:
                    check_agent(name, task, role)

    def check_league(self, names: Sequence[str]) -> None:
        """As of `TaskForm`: chasers and evaders only."""
        task = self.build()
        check(
            bool(task.num_chasers and task.num_evaders),
            f"task {task.name!r}: a league needs chasers and evaders",
        )
        check(not task.num_runners, f"task {task.name!r} has runners; a league has none")

    @property
    def how_fixed(self) -> tuple[Any, ...]:
        """As of `TaskForm`; random moves are those of A*."""
        return 0.0, self.opponent_policy, self.opponent_observation

    def beside(self, run: str) -> Self:
        """As of `TaskForm`; random moves are those of scripted agents."""
        return replace(self, opponent=run, opponent_policy="sampled")

    def profile(self) -> TaskProfile:
        """As of `TaskForm`: task, role and size."""
        task = self.build()
        return TaskProfile(
            self.task,
            self.agent_in(task).split("_")[0],
            task.max_cells,
            random_start=self.start == "random",
            duel=task.is_duel,
            many_mazes=len(task.mazes) > 1,
            goals=task.num_goals,
        )

    def check_observation(self, name: str) -> None:
        """As of `TaskForm`."""
        check_observation(name)

    def usual_network(self, observation: str, device: str) -> str:
        """As of `TaskForm`: planning for runners in unseen mazes, convolutions for other planes."""
        task = self.build()
        if len(Encoder(task, observation).shape) < 3:
            return "mlp"
        unseen = self.agent.startswith("runner") and len(task.mazes) > 1
        plans = unseen and device == "cpu" and is_builtin(observation)
        return "planning" if plans else "convolutions"

    @property
    def unused(self) -> Mapping[str, str]:
        """As of `TaskForm`: opponents, captures and exits of games without these."""
        task, found = self.build(), dict(DISCRETE)
        if task.num_agents == 1:
            names = (*OPPONENT, "opponent_observation")
            found |= dict.fromkeys(names, f"task {self.task!r} has no other agent")
        if not (task.num_chasers and task.num_evaders):
            found |= dict.fromkeys(CAPTURING, f"task {self.task!r} has no chasers and evaders")
        if not task.num_evaders:
            found |= dict.fromkeys(("exits", "num_exits"), f"task {self.task!r} has no evaders")
        return found

    def check_used(self) -> None:
        """As of `TaskForm`; also rewards of no agents."""
        super().check_used()
        task = self.build()
        given = rewards_from_text(self.rewards) if is_coefficients(self.rewards) else {}
        if len(given) < len(ROLES):  # coefficients without a role apply to all of them
            for role in given:
                check(
                    role in task.seat_roles,
                    f"rewards={self.rewards!r}: task {self.task!r} has no {role}; its roles are "
                    f"{', '.join(dict.fromkeys(task.seat_roles))}",
                )

    def frozen(self) -> Self:
        """As of `TaskForm`: maze files as text."""
        return replace(self, maze=as_text(self.maze))

    @property
    def maze_text(self) -> str | None:
        """As of `TaskForm`."""
        maze = maze_or_suite(self.maze)
        return None if isinstance(maze, str) else maze.to_text()


def learning_agent(task: str, role: str) -> str:
    """The given role; for "auto" the first role of the task."""
    if role != "auto":
        return role
    return "runner" if task in ("maze", "race") else "chaser"


_built_once = lru_cache(maxsize=4)(make_task)
"""Tasks are immutable, and a run needs its task in several places."""


@dataclass(frozen=True)
class ReacherSettings(TaskForm):
    """An arm that moves its tip to a target in as few steps as possible."""

    OBSERVATION: ClassVar[str] = "positions"
    ENV_OBSERVATION: ClassVar[str] = "positions"
    TASKS: ClassVar[tuple[str, ...]] = (REACHER,)
    IDENTITY: ClassVar[tuple[str, ...]] = ()

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
        """As of `TaskForm`."""
        return f"{self.task}-{self.joints}"

    def build(self) -> ReacherTask:
        """As of `TaskForm`."""
        return ReacherTask(**{name: own for name, own in vars(self).items() if name != "task"})

    def profile(self) -> TaskProfile:
        """As of `TaskForm`: the joints."""
        return TaskProfile(self.task, "arm", 0, joints=self.joints, tuned="arms")

    def usual_network(self, observation: str, device: str) -> str:
        """As of `TaskForm`."""
        return "mlp"

    @property
    def unused(self) -> Mapping[str, str]:
        """As of `TaskForm`."""
        return DISCRETE if self.discrete_actions else {}

    def check_observation(self, name: str) -> None:
        """As of `TaskForm`."""
        one_of("observation", name, ARM_ENCODINGS)


@dataclass(frozen=True)
class SmallGameSettings(TaskForm):
    """A small game, whose states are all enumerated, and the policies of the other players."""

    AGENT: ClassVar[str] = "player"
    POLICIES: ClassVar[tuple[str, ...]] = OPPONENT
    AGENTS: ClassVar[tuple[str, ...]] = GAME_AGENTS
    TASKS: ClassVar[tuple[str, ...]] = (GAME,)
    IDENTITY: ClassVar[tuple[str, ...]] = ("game",)

    task: Annotated[str, choice(GAME)] = GAME
    """game (for the options of games in mazes see --task chase --help)."""
    game: str = ""  # type: ignore[assignment]
    """Name of the game: a shipped one such as soccer or goofspiel(cards=4), openspiel:NAME(...), or
    package.module:Name(size=4) of a class or function that returns a Game."""
    player: str = "auto"
    """Learning player, by name. auto: the first."""
    max_steps: Steps = 200
    """Steps after which an episode is truncated, at most 100,000."""
    opponent: Annotated[str, AGENT] = "uniform"
    """Policy of the other players: uniform, equilibrium (of a zero-sum game of two), the folder of
    a run, an exported policy (.onnx), or package.module:Name of a function of a state that returns
    probabilities."""
    opponent_epsilon: Annotated[float, RANDOM_MOVES] = 0.0
    """Probability of a uniformly random action of the opponents, in [0, 1]."""
    opponent_policy: Annotated[str, choice("sampled", "greedy")] = "sampled"
    """Policy of a learned opponent: sampled (from its distribution), or greedy (the most probable
    action)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        split_name(self.game)

    @classmethod
    def is_named(cls, given: Mapping[str, object]) -> bool:
        """As of `TaskForm`; also by the name of a game alone."""
        return super().is_named(given) or given.get("game") is not None

    @property
    def label(self) -> str:
        """As of `TaskForm`."""
        name = "-".join(re.findall(r"[\w.]+", self.game.removeprefix(OPENSPIEL)))
        return name if self.player == "auto" else f"{name}-{self.player}"

    def build(self) -> GameTask:
        """The game, enumerated; one object for equal settings.

        Raises:
            ValueError: no such game, or one that cannot be enumerated.
        """
        return _game_with(self.game, self.max_steps)

    @property
    def sides(self) -> tuple[str, ...]:
        """As of `TaskForm`: the players; the game is not enumerated."""
        return _players_named(self.game)

    def check_league(self, names: Sequence[str]) -> None:
        """As of `TaskForm`, before the game is enumerated."""
        check(
            EQUILIBRIUM not in names or getattr(game_named(self.game), "zero_sum", True),
            f"game={self.game!r} is a general-sum game, whose equilibrium is not computed; leave "
            f"{EQUILIBRIUM} out",
        )

    @property
    def discount(self) -> float:
        """As of `TaskForm`: 1 if the game always ends within `max_steps`."""
        longest = _longest_play(self.build())
        ends = longest is not None and longest <= self.max_steps
        return 1.0 if ends else GAME_DISCOUNT

    unused: ClassVar[Mapping[str, str]] = DISCRETE

    def usual_network(self, observation: str, device: str) -> str:
        """As of `TaskForm`."""
        dimensions = self.build().observations(self.sides[0], observation).ndim - 1
        return "mlp" if dimensions < 3 else "convolutions"

    def check_observation(self, name: str) -> None:
        """As of `TaskForm`."""
        one_of("observation", name, GAME_ENCODINGS)


@lru_cache(maxsize=KEPT)
def _game_with(name: str, max_steps: int) -> GameTask:
    return GameTask(load_game(name), name, max_steps)


@lru_cache(maxsize=KEPT)
def _players_named(game: str) -> tuple[str, ...]:
    return names_of_players(game_named(game))


@lru_cache(maxsize=KEPT)
def _longest_play(task: GameTask) -> int | None:
    return longest_play(task.game)


FORMS += [SmallGameSettings, ReacherSettings, TaskSettings]
