"""The base of the settings of tasks, and the form of a task by its name."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self, TypeAlias

from pursuit.plugins import Registry, is_reference
from pursuit.validation import check, one_of
from train.settings.checks import Settings, check_default
from train.settings.profile import TaskProfile


@dataclass(frozen=True)
class TaskForm(Settings):
    """The settings of a task of one family, and of the policies of its other agents.

    Attributes:
        OBSERVATION, ENV_OBSERVATION: the default observations of learners and of environments.
        AGENT: the setting with the learning agent; "" where there is one agent only.
        POLICIES: the settings of the policies of other agents.
        AGENTS: the names of built-in policies.
        TASKS: the names of its tasks.
        IDENTITY: settings that a default of the form needs.
        game: the name of a game that is measured in returns, in rows of studies; None for others.
    """

    OBSERVATION: ClassVar[str] = "index"
    ENV_OBSERVATION: ClassVar[str] = "one_hot"
    AGENT: ClassVar[str] = ""
    POLICIES: ClassVar[tuple[str, ...]] = ()
    AGENTS: ClassVar[tuple[str, ...]] = ()
    TASKS: ClassVar[tuple[str, ...]] = ()
    IDENTITY: ClassVar[tuple[str, ...]] = ("task",)

    task: str = ""
    """Name of the task."""
    game = None  # without annotation it is no field

    @property
    @abstractmethod
    def max_steps(self) -> int:
        """Steps after which an episode is truncated."""

    @classmethod
    def is_named(cls, given: Mapping[str, object]) -> bool:
        """Whether these settings name a task of this form."""
        return given.get("task") in cls.TASKS

    @property
    def agent(self) -> str:
        """The learning agent or role, as given."""
        return str(vars(self)[self.AGENT]) if self.AGENT else "auto"

    @property
    def label(self) -> str:
        """The beginning of the name of a run's folder."""
        return self.task.rpartition(":")[2]

    @property
    def game_label(self) -> str:
        """As `label`, without the learning agent."""
        return self.label

    @abstractmethod
    def build(self) -> Any:
        """The task itself, a `Rules`; ValueError for settings that it does not allow."""

    def agent_in(self, task: Any) -> str:
        """The learning agent; ValueError unless the task has it."""
        if self.agent == "auto" or self.agent in task.seat_roles:
            return self.agent if self.agent != "auto" else str(task.seat_roles[0])
        return str(task.agent_names[task.seat(self.agent)])

    def with_agent(self, agent: str) -> Self:
        """The same settings for another learning agent."""
        own: Any = {self.AGENT: agent} if self.AGENT else {}
        return replace(self, **own)

    @property
    def sides(self) -> tuple[str, ...]:
        """The roles or agents that learn against each other in self-play; ValueError for none."""
        raise ValueError(f"task {self.task!r} has no sides; use `pursuit train`")

    @classmethod
    def for_self_play(cls, given: Mapping[str, object]) -> Mapping[str, object]:
        """The defaults in self-play that differ from the others, where these settings are given."""
        return {}

    def check_self_play(self, sides: Mapping[str, object], members: Sequence[str]) -> None:
        """ValueError unless this task has these sides of self-play and members of their pools."""

    def check_league(self, names: Sequence[str]) -> None:
        """ValueError unless this task, and the built-in policies of these names, fit a league."""

    @property
    def how_fixed(self) -> tuple[Any, ...]:
        """Of fixed policies in self-play: the share of random moves, sampled or greedy, and the
        observation of models; as of `policy_named`."""
        own = vars(self)
        return own.get("opponent_epsilon", 0.0), own.get("opponent_policy", "sampled")

    def beside(self, run: str) -> Self:
        """Those of one side of self-play with the policies of the other sides of this run."""
        own: Any = {"opponent": run, "opponent_policy": "sampled", "opponent_epsilon": 0.0}
        return replace(self, **{name: own[name] for name in self.POLICIES})

    def profile(self) -> TaskProfile:
        """What presets depend on."""
        return TaskProfile(self.task, self.agent, 0)

    @property
    def discount(self) -> float | None:
        """The default discount; None for that of the algorithm."""
        return None

    def hint(self) -> str:
        """A line for users who train one agent of this task; "" for none."""
        return ""

    def check_observation(self, name: str) -> None:
        """ValueError unless this observation exists; by default there is one."""
        one_of("observation", name, (self.OBSERVATION,))

    def usual_network(self, observation: str, device: str) -> str:
        """What network "auto" means; "auto" where only the games say it."""
        return "auto"

    @property
    def unused(self) -> Mapping[str, str]:
        """The settings of a run, of any of its parts, without effect in this task: the reasons."""
        return {}

    def check_used(self) -> None:
        """ValueError for a setting that is changed from its default without effect."""
        for name, why in self.unused.items():
            if name in vars(self):
                check_default(self, type(self), [name], why)

    def frozen(self) -> Self:
        """The same settings with the contents of files in place of their names."""
        return self

    @property
    def maze_text(self) -> str | None:
        """The maze as text; None if there is none, and for a suite, which has its own files."""
        return None


def with_values(task: Any, what: str, **values: Any) -> Any:
    """The settings of a task with these values; ValueError unless it has such settings.

    `what` starts the message.
    """
    names = {each.name for each in fields(task)}
    check(names >= set(values), f"{what}: not for task {task.task!r}; use a game in mazes")
    return replace(task, **values)


FAMILIES: Registry[Any] = Registry(
    "family",
    "a train.families.Family",
    lambda part: isinstance(getattr(part, "settings", None), type),
    plural="families",
)
"""User-defined families, by the name of their task."""

FORMS: list[type[TaskForm]] = []
"""The forms of this package; the last is that of unknown names, which it refuses."""


def task_form(given: Mapping[str, object]) -> type[Any]:
    """The form of the settings of a task, by those of its settings that name it."""
    name = given.get("task")
    if isinstance(name, str) and (is_reference(name) or name in FAMILIES.names()):
        form: type[Any] = FAMILIES.get(name).settings
        return form
    return next((form for form in FORMS if form.is_named(given)), FORMS[-1])


def default_task(given: Mapping[str, str]) -> Any:
    """The default settings of the task that these settings name."""
    form = task_form(given)
    return form(**{name: given[name] for name in form.IDENTITY if name in given})


AnyTask: TypeAlias = Any
"""A `TaskForm`: the command line takes the options of a task from the form of its default."""
