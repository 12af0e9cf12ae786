"""What is played, and against whom, by name: games in mazes, and the arm."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pursuit.mazes.suite_files import PREFIX, is_suite
from pursuit.observations.own import check_observation
from pursuit.reacher.observations import ENCODINGS as ARM_ENCODINGS
from pursuit.reacher.task import ReacherTask
from pursuit.tasks.rewards import kept_rewards, rewards_text
from pursuit.tasks.sight import chosen_text, kept_chosen, kept_radius, radius_text
from pursuit.tasks.task import TASK_NAMES
from train.settings.checks import RANDOM_MOVES, Rule, Settings, check, check_choice, one_of, rule

REACHER = "reacher"
MOST_STEPS = 100_000
Steps = Annotated[
    int,
    rule(
        lambda value: value <= MOST_STEPS,
        f"at most {MOST_STEPS}: evaluations play every episode to its end, and an agent that is "
        "never caught reaches the limit; take fewer",
    ),
]


def kept_text_of_rewards(name: str, given: Any) -> str:
    """Rewards as one text."""
    text = rewards_text(given)
    if text != "default":
        kept_rewards(name, text)
    return text


def kept_text_of_radius(name: str, given: Any) -> str | None:
    """Radii of sight as one text; None for none."""
    return radius_text(kept_radius(name, given))


def kept_text_of_agents(name: str, given: Any) -> str:
    """Roles and agents as one text."""
    return chosen_text(kept_chosen(name, given))


@dataclass(frozen=True)
class TaskSettings(Settings):
    """What is played, and against whom."""

    OBSERVATION: ClassVar[str] = "index"

    task: str = "chase"
    """chase, maze, race, heist, or reacher, which has options of its own: see --task reacher
    --help."""
    role: str = "auto"
    """Who learns: chaser, evader or runner (or one agent, such as chaser_1). auto: the first."""
    maze: str = "5x5"
    """A shipped maze (2x2 ... 9x9, 15x15, also -tree and -open), the path of a maze file, or a
    frozen suite of mazes, such as suite:7x7-train (or suite:7x7-train/0-99)."""
    num_chasers: int | None = None
    """Chasers; the task's own number if left out."""
    num_evaders: int | None = None
    """Evaders; likewise."""
    num_runners: int | None = None
    """Runners; likewise."""
    num_goals: int | None = None
    """Goals; likewise."""
    max_steps: Steps = 200
    """An episode of this many steps is truncated; 100,000 at most."""
    stay_action: bool = False
    """Whether a fifth action, stay, exists."""
    move_order: str = "simultaneous"
    """simultaneous, or chasers_first."""
    min_start_distance: int = 1
    """Steps between chasers and evaders at the start, at least."""
    rewards: Annotated[str, Rule(kept_text_of_rewards, other_types=True)] = "default"
    """goal, completion, distance, zero_sum, or the task's own (default); coefficients, such as
    step=-0.1,capture=2 or chaser.step=-0.1,evader.capture=-2 (of step, capture, goal, distance,
    on_completion, for chasers per_evader); or package.module:Name of a function of your own."""
    view_radius: Annotated[str | None, Rule(kept_text_of_radius, other_types=True)] = None
    """Path steps up to which agents see: a number for all, or by role or agent, such as
    chaser=2,evader_0=3; everything if left out. The scripted astar, random and optimal see
    everything all the same."""
    line_of_sight: Annotated[str, Rule(kept_text_of_agents, other_types=True)] = ""
    """Who sees along rows and columns only, until a wall: all (or no value), or roles and agents,
    such as chaser,evader_0; with a view_radius so far only. Nobody if left out."""
    unknown_maze: Annotated[str, Rule(kept_text_of_agents, other_types=True)] = ""
    """Who knows of the maze only what is within view: all (or no value), or roles and agents.
    Nobody if left out."""
    opponent_epsilon: Annotated[float, RANDOM_MOVES] = 0.2
    """Share of random moves of the scripted agents in all other seats, in [0, 1]."""
    opponent: str | None = None
    """Who plays the other side instead of A*: random, optimal (exactly), searching (chasers also
    sweeping, belief; all three see what the task lets them), the folder of a run, a saved
    Stable-Baselines3 model (.zip), or package.module:Name of your own. Learned ones play as
    opponent_policy says."""
    opponent_policy: Annotated[str, one_of("sampled", "greedy")] = "sampled"
    """How a learned opponent plays: sampled (as it was learned, where it is a distribution), or
    greedy (always the most probable action)."""
    opponent_observation: str | None = None
    """What a saved Stable-Baselines3 model observes that plays the other side, such as one_hot; of
    one without a description beside it (as model.save() writes)."""
    start: str = "random"
    """random, or marks: the S and G of the maze (fixed goals)."""
    mask_bumps: bool = False
    """Forbid the learner moves into walls, as it learns and as it plays. Without the stay action
    they are the only way to wait, which the best chasers and evaders do."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.task != REACHER,
            f"task={self.task!r} is no game in mazes; take {', '.join(TASK_NAMES)} here, and the "
            "arm in `pursuit train`, `baseline`, `render` or a sweep (ReacherSettings in Python)",
        )
        check_choice("task", self.task, (*TASK_NAMES, REACHER))

    @property
    def agent(self) -> str:
        """Who learns."""
        return learning_agent(self.task, self.role)

    @property
    def label(self) -> str:
        """What the folder of a run is called after."""
        maze = self.maze.removeprefix(PREFIX).replace("/", "-")
        return f"{self.task}-{self.agent}-{maze if is_suite(self.maze) else Path(self.maze).stem}"

    def check_observation(self, name: str) -> None:
        """ValueError unless it can be observed."""
        check_observation(name)


def learning_agent(task: str, role: str) -> str:
    """The role that is named, or the first of a task for "auto"."""
    if role != "auto":
        return role
    return "runner" if task in ("maze", "race") else "chaser"


@dataclass(frozen=True)
class ReacherSettings(Settings):
    """An arm that is to bring its tip to a target, in as few steps as it can."""

    OBSERVATION: ClassVar[str] = "positions"

    task: Annotated[str, one_of(REACHER)] = REACHER
    """reacher; the games in mazes have options of their own: see --task chase --help."""
    joints: int = 2
    """Joints, 1 to 8; links have length 1."""
    start: str = "kept"
    """The pose that an episode begins in: kept from the last one, random, or fixed (straight)."""
    hold: int = 1
    """Steps in a row after which the tip must be in reach of the target."""
    tolerance: float = 0.2
    """It is in reach within this distance."""
    max_steps: Steps = 400
    """An episode of this many steps is truncated; 100,000 at most."""
    max_turn: float = 0.1
    """Radians that a joint turns in a step, at most."""
    effort: float = 0.01
    """Cost of turning one joint as far as it goes."""
    discrete_actions: bool = False
    """Every joint turns fully, back or forth, or not at all."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.build()

    @property
    def label(self) -> str:
        """What the folder of a run is called after."""
        return f"{self.task}-{self.joints}"

    def build(self) -> ReacherTask:
        """The task itself; ValueError for what it does not allow."""
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        return ReacherTask(**{name: value for name, value in given.items() if name != "task"})

    def check_observation(self, name: str) -> None:
        """ValueError unless it can be observed."""
        check_choice("observation", name, ARM_ENCODINGS)


AnyTask = TaskSettings | ReacherSettings


def in_maze(task: AnyTask, what: str) -> TaskSettings:
    """`task`, if it is a game in mazes; ValueError naming `what` needs one for another."""
    if isinstance(task, ReacherSettings):
        raise ValueError(f"{what}: games in mazes are needed, and task {task.task!r} has none")
    return task


def task_form(name: Any) -> type[AnyTask]:
    """The settings of a task by its name; those of mazes for an unknown one, which they refuse."""
    return ReacherSettings if name == REACHER else TaskSettings
