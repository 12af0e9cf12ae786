"""Settings: frozen dataclasses, checked at birth; the command line is generated from them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import Any

from pursuit.maze import Maze, load_maze
from pursuit.observations import ENCODINGS
from pursuit.policy import Policy
from pursuit.task import TASK_NAMES, Task, make_task
from scripted_agents.environments import default_policies

ALGORITHMS = ("ppo",)
PRECISIONS = ("auto", "float32", "bfloat16")
FIRST_LAYERS = ("auto", "bag", "dense")


def check(condition: bool, message: str) -> None:
    """Raise ValueError(message) unless `condition`."""
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True)
class TaskSettings:
    """What is played, and against whom."""

    task: str = "chase"
    """chase, maze, race or heist."""
    role: str = "auto"
    """Who learns: chaser, evader or runner (or one agent, such as chaser_1). auto: the first."""
    maze: str = "5x5"
    """A shipped maze (2x2 ... 9x9, 15x15, also -tree and -open), or the path of a maze file."""
    num_chasers: int | None = None
    """Chasers; the task's own number if left out."""
    num_evaders: int | None = None
    """Evaders; likewise."""
    num_runners: int | None = None
    """Runners; likewise."""
    num_goals: int | None = None
    """Goals; likewise."""
    max_steps: int = 200
    """An episode of this many steps is truncated."""
    stay_action: bool = False
    """Whether a fifth action, stay, exists."""
    move_order: str = "simultaneous"
    """simultaneous, or chasers_first."""
    min_start_distance: int = 1
    """Steps between chasers and evaders at the start, at least."""
    rewards: str = "default"
    """goal, completion, distance, zero_sum, or the task's own (default)."""
    opponent_epsilon: float = 0.2
    """Share of random moves of the scripted agents in all other seats, in [0, 1]."""

    def __post_init__(self) -> None:
        check(
            0.0 <= self.opponent_epsilon <= 1.0,
            f"opponent_epsilon={self.opponent_epsilon}; a share of random moves lies in [0, 1]",
        )
        check(
            self.task in TASK_NAMES,
            f"unknown task {self.task!r}; one of {', '.join(TASK_NAMES)}",
        )
        agent = self.agent
        task = self.build()
        known = {*task.agent_names, *task.seat_roles}
        check(
            agent in known,
            f"role {agent!r} does not play in task {self.task!r}; one of "
            f"{', '.join(sorted(known))}",
        )

    @property
    def agent(self) -> str:
        """Who learns."""
        if self.role != "auto":
            return self.role
        return "runner" if self.task in ("maze", "race") else "chaser"

    def build(self) -> Task:
        """The `Task`."""
        given = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name.startswith("num_") and getattr(self, field.name) is not None
        }
        if self.rewards != "default":
            given["rewards"] = self.rewards
        return make_task(
            self.task,
            maze=Maze.from_text(self.maze) if "\n" in self.maze else load_maze(self.maze),
            max_steps=self.max_steps,
            stay_action=self.stay_action,
            move_order=self.move_order,
            min_start_distance=self.min_start_distance,
            **given,
        )

    def opponents(self) -> dict[str, Policy]:
        """The scripted policy of every role."""
        return default_policies(self.build(), self.opponent_epsilon, own=self.agent)


@dataclass(frozen=True)
class PPOSettings:
    """Proximal policy optimisation (Schulman et al., 2017), and the size of the network."""

    num_games: int = 1024
    """Games in lockstep."""
    rollout_steps: int = 16
    """Steps of every game between two updates."""
    minibatch: int = 4096
    """Frames of one gradient step."""
    epochs: int = 2
    """Passes over each rollout."""
    learning_rate: float = 1e-2
    """Of Adam, at the start; it is annealed in a straight line to 0."""
    gamma: float = 0.95
    """Discount."""
    gae_lambda: float = 0.9
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """Clipping of the probability ratio."""
    entropy: float = 0.01
    """Weight of the entropy bonus at the start; annealed to 0."""
    value_weight: float = 0.5
    """Weight of the value loss."""
    max_grad_norm: float = 0.5
    """Gradients are scaled down to this norm."""
    width: int = 128
    """Units of each of the two hidden layers."""
    first_std: float = 0.06
    """Standard deviation of the first layer's weights on index at the start."""
    shared: bool = True
    """Whether policy and value share their hidden layers."""

    def __post_init__(self) -> None:
        for name in ("num_games", "rollout_steps", "minibatch", "epochs", "width"):
            check(getattr(self, name) >= 1, f"{name}={getattr(self, name)}; it is at least 1")
        for name in ("learning_rate", "max_grad_norm", "clip", "first_std"):
            check(getattr(self, name) > 0, f"{name}={getattr(self, name)}; it is above 0")
        for name in ("gamma", "gae_lambda"):
            value = getattr(self, name)
            check(0.0 <= value <= 1.0, f"{name}={value}; it lies in [0, 1]")
        for name in ("entropy", "value_weight"):
            check(getattr(self, name) >= 0, f"{name}={getattr(self, name)}; it is at least 0")
        frames = self.num_games * self.rollout_steps
        check(
            self.minibatch <= frames,
            f"minibatch={self.minibatch} is more than a rollout of num_games × rollout_steps = "
            f"{frames} frames; lower it",
        )


@dataclass(frozen=True)
class TrainSettings:
    """One training run, complete: what `config.json` holds."""

    task: TaskSettings = field(default_factory=TaskSettings)
    ppo: PPOSettings = field(default_factory=PPOSettings)
    algorithm: str = "ppo"
    """The learner."""
    observation: str = "index"
    """What the network is given: index (the same network as one_hot, faster), one_hot, positions,
    cells, walls or planes (convolutions)."""
    seconds: float | None = None
    """Budget of training time; evaluations are not counted."""
    frames: int | None = None
    """Budget of environment steps, all games counted. With it, a resumed run ends bit for bit where
    an uninterrupted one does."""
    seed: int = 0
    """Of the games, the network and the exploration."""
    device: str = "cpu"
    """Where the network lives: cpu or cuda. The games run on the CPU."""
    precision: str = "auto"
    """float32, bfloat16, or auto: bfloat16 where the processor has it in hardware."""
    first_layer: str = "auto"
    """Form of the first layer on index: bag, dense, or auto (the faster, as measured)."""
    threads: int = 0
    """Threads of torch. 0 is one for each core; with a budget in seconds, one or all of them,
    whichever is the faster at the time."""

    def __post_init__(self) -> None:
        for name, choices in (
            ("algorithm", ALGORITHMS),
            ("observation", ENCODINGS),
            ("precision", PRECISIONS),
            ("first_layer", FIRST_LAYERS),
        ):
            value = getattr(self, name)
            check(value in choices, f"unknown {name} {value!r}; one of {', '.join(choices)}")
        check(
            (self.seconds is None) != (self.frames is None),
            f"seconds={self.seconds} and frames={self.frames}; give one of the two as the budget",
        )
        check(
            self.seconds is None or 0 < self.seconds < float("inf"),
            f"seconds={self.seconds}; it is above 0",
        )
        check(self.frames is None or self.frames > 0, f"frames={self.frames}; it is above 0")
        check(0 <= self.seed < 2**63, f"seed={self.seed}; 0 to 2**63-1")
        check(self.threads >= 0, f"threads={self.threads}; at least 0")
        check(
            self.device == "cpu" or self.device.split(":")[0] == "cuda",
            f"unknown device {self.device!r}; cpu or cuda (or cuda:1, ...)",
        )

    def to_plain(self) -> dict[str, Any]:
        """As nested dicts of plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> TrainSettings:
        """What `to_plain` gave.

        Raises:
            ValueError: missing or unknown settings, or values that are not allowed.
        """
        try:
            inner = {
                "task": TaskSettings(**plain["task"]),
                "ppo": PPOSettings(**plain["ppo"]),
            }
            return cls(**{**plain, **inner})
        except (TypeError, KeyError) as error:
            raise ValueError(f"these are not the settings of a run: {error}") from None
