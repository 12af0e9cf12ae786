"""Settings: frozen dataclasses, checked at birth; the command line is generated from them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Generic, TypeVar

from pursuit.maze import Maze, load_maze
from pursuit.observations import ENCODINGS
from pursuit.policy import Policy
from pursuit.task import TASK_NAMES, Task, make_task
from scripted_agents.environments import SCRIPTED, default_policies, scripted_policy
from train.settings.algorithms import (
    HYPERPARAMETERS,
    Hyperparameters,
    PPOSettings,
    algorithm_name,
)
from train.settings.checks import check
from train.settings.curricula import CURRICULA, CurriculumSettings, curriculum_form
from train.settings.presets import (
    TUNED,
    Setting,
    hyperparameters,
    lessons_for,
    preset_algorithm,
)

H = TypeVar("H", bound=Hyperparameters, covariant=True)
EVALUATED = ("greedy", "sampled")
PRECISIONS = ("auto", "float32", "bfloat16")
FIRST_LAYERS = ("auto", "bag", "dense")


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
    opponent: str | None = None
    """Who plays the other side instead of A*: random, optimal (exactly), the folder of a run, or a
    saved Stable-Baselines3 model (.zip)."""
    start: str = "random"
    """random, or marks: the S and G of the maze (fixed goals)."""

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

    @property
    def setting(self) -> Setting:
        """What presets depend on."""
        task = self.build()
        role = task.seat_roles[task.seat(self.agent)]
        return Setting(self.task, role, task.max_cells, self.start == "random", task.is_duel)

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
            start=self.start,
            **given,
        )

    def opponents(self) -> dict[str, Policy]:
        """The policy of every role: scripted, and where there is one, `opponent` for its own.

        Raises:
            ValueError: no policy at `opponent`, or one that cannot play against the learner.
        """
        task = self.build()
        policies = default_policies(task, self.opponent_epsilon, own=self.agent)
        if self.opponent in SCRIPTED:
            role = self.agent.split("_")[0]
            for other in set(task.seat_roles) - {role}:
                rest: Any = (self.opponent_epsilon, self.move_order)
                policies[other] = scripted_policy(str(self.opponent), other, *rest)
        elif self.opponent is not None:
            from train.runs.third_party import load_opponent

            policy: Any = load_opponent(Path(self.opponent))
            role = policy.task.seat_roles[policy.task.seat(policy.agent)]
            seat = task.seat(self.agent)
            others = [r for s, r in enumerate(task.seat_roles) if s != seat]
            check(
                role in others,
                f"opponent={self.opponent!r} learned to be {role!r}; the other seats of task "
                f"{task.name!r} are {', '.join(others) or 'none'}; give a policy of another role",
            )
            policies[role] = policy
        return policies


@dataclass(frozen=True)
class TrainSettings(Generic[H]):
    """One training run, complete: what `config.json` holds."""

    task: TaskSettings = field(default_factory=TaskSettings)
    hyper: H = field(default_factory=PPOSettings)  # type: ignore[assignment]
    """The settings of the algorithm."""
    lessons: CurriculumSettings = field(default_factory=CurriculumSettings)
    """The settings of the curriculum."""
    algorithm: str = "ppo"
    """The learner: ppo, a2c, reinforce, dqn, cross_entropy or q_learning."""
    curriculum: str = "none"
    """What is taught when. Scheduled: opponent-epsilon, goal-spread-fixed, goal-spread-start,
    start-distance, num-goals, maze-size, loops. Adaptive: success-gated, learning-progress,
    level-replay, learnability. Controls: none, uniform, reversed, shuffled."""
    observation: str = "index"
    """What the network is given: index (the same network as one_hot, faster), one_hot, positions,
    cells, walls or planes (convolutions)."""
    evaluate: str = "greedy"
    """Which policy is evaluated: greedy (the most probable action), or sampled (as learned: it
    gets away where the greedy one steps to and fro for ever). Final results have both."""
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
            ("algorithm", HYPERPARAMETERS),
            ("observation", ENCODINGS),
            ("evaluate", EVALUATED),
            ("precision", PRECISIONS),
            ("first_layer", FIRST_LAYERS),
        ):
            value = getattr(self, name)
            check(value in choices, f"unknown {name} {value!r}; one of {', '.join(choices)}")
        check(
            algorithm_name(self.hyper) == self.algorithm,
            f"algorithm={self.algorithm!r} with settings of {algorithm_name(self.hyper)!r}",
        )
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
        check(
            type(self.lessons) is curriculum_form(self.curriculum),
            f"curriculum={self.curriculum!r} with settings of {type(self.lessons).__name__}",
        )
        from train.runs.run import check_settings

        check_settings(self)

    def to_plain(self) -> dict[str, Any]:
        """As nested dicts of plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> TrainSettings[Any]:
        """What `to_plain` gave.

        Raises:
            ValueError: missing or unknown settings, or values that are not allowed.
        """
        try:
            inner: dict[str, Any] = {
                "task": TaskSettings(**plain["task"]),
                "hyper": HYPERPARAMETERS[plain["algorithm"]](**plain["hyper"]),
                "lessons": CURRICULA[plain["curriculum"]](**plain["lessons"]),
            }
            return cls(**{**plain, **inner})
        except (TypeError, KeyError) as error:
            raise ValueError(f"these are not the settings of a run: {error}") from None


def settings_of(**flat: Any) -> TrainSettings[Any]:
    """Settings by their names on the command line, with `preset` for what is left out.

    `settings_of(algorithm="dqn", maze="7x7", task="maze", seconds=60, learning_rate=1e-3)`.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    given = dict(flat)
    preset = given.pop("preset", TUNED)
    algorithm = given.get("algorithm", preset_algorithm(preset) or "ppo")
    task_names = {field.name for field in fields(TaskSettings)}
    task = TaskSettings(**_typed(TaskSettings, {k: v for k, v in given.items() if k in task_names}))
    hyper = hyperparameters(algorithm, task.setting, preset)
    curriculum, lessons = lessons_for(algorithm, task.setting, preset, given.get("curriculum"))
    hyper_names = {field.name for field in fields(hyper)}
    lesson_names = {field.name for field in fields(lessons)}
    own_names = {field.name for field in fields(TrainSettings)} - {"task", "hyper", "lessons"}
    for name in given:
        known = sorted({*task_names, *hyper_names, *lesson_names, *own_names, "preset"})
        close = get_close_matches(name, known, 1)
        check(
            name in known,
            f"unknown setting {name!r} for algorithm {algorithm!r} and curriculum {curriculum!r}"
            + (f"; did you mean {close[0]!r}?" if close else f"; one of {', '.join(known)}"),
        )
    changed = _typed(type(hyper), {k: v for k, v in given.items() if k in hyper_names})
    taught = _typed(type(lessons), {k: v for k, v in given.items() if k in lesson_names})
    own = _typed(TrainSettings, {k: v for k, v in given.items() if k in own_names})
    return TrainSettings(
        **{
            **own,
            "algorithm": algorithm,
            "task": task,
            "hyper": type(hyper)(**{**asdict(hyper), **changed}),
            "curriculum": curriculum,
            "lessons": type(lessons)(**{**asdict(lessons), **taught}),
        }
    )


def _typed(form: type[Any], given: dict[str, Any]) -> dict[str, Any]:
    """`given` with whole numbers made floats where a float is meant; ValueError for other types."""
    wanted = {field.name: str(field.type) for field in fields(form)}
    result = {}
    for name, value in given.items():
        kind = wanted[name]
        if "float" in kind and type(value) is int:
            value = float(value)
        kinds = {"bool": bool, "int": int, "float": float, "str": str}
        fits = any(word in kind and type(value) is known for word, known in kinds.items())
        check(
            fits or ("None" in kind and value is None),
            f"{name}={value!r}; it is of type {kind.replace(' | None', '')}",
        )
        result[name] = value
    return result
