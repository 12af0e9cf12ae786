"""The runs of a comparison of libraries: each learns a task on one core, by an ordinary run.

The settings of a run are written in the terms of a comparison, as every library has the same:
`ordinary` makes those of `pursuit train` of them. What a comparison adds to the run is that greedy
and sampled policies are evaluated, that both clocks are measured, and that imports and compilation
count for nobody, by an iteration of a learner that is discarded.

A further library is an algorithm with the settings of `OBEYED`, by its name.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import torch

from pursuit.compilation.compiler import now_without_compilation
from pursuit.validation import at_least, check, choice, one_of, unknown
from scripted_agents.exact.limits import MAX_EXACT_GOALS
from train.algorithms.registry import ALGORITHMS, entry
from train.evaluation.scores import BY_STEPS, optimality_gap
from train.experiments.study import Table, check_budget
from train.files import Plain
from train.kinds import KINDS, Kind
from train.runs.budget import Budget
from train.runs.folder import load_config
from train.runs.forms import RESTORE
from train.runs.loop import Run, build_parts, build_run, evenly
from train.runs.parts import Parts, parts_of
from train.runs.single import SingleAgent
from train.runs.threads import prepare_torch
from train.runs.trainee import Clock
from train.runs.worlds import task_world_of
from train.schemas import read_as
from train.settings.algorithms import LEARNERS, LibraryPPOSettings, PPOSettings, hyperparameter_form
from train.settings.checks import CLOCKS, SEED, Settings
from train.settings.curricula import CurriculumSettings
from train.settings.presets import curriculum_for, tuned
from train.settings.reading import plain_settings
from train.settings.run import AgentSettings, TrainSettings
from train.settings.task import TaskSettings

LIBRARY_RUN = "contestant"
"""The kind of these runs."""
OBEYED = tuple(f.name for f in fields(LibraryPPOSettings) if f.name != "recurrent")
"""The settings that every library has; a search may draw these."""
WARM_UP_SEED = 2**31
"""Seed of the discarded learner."""


@dataclass(frozen=True)
class ComparedLibrary:
    """A library in the comparison, by its learner; ours is one too.

    Attributes:
        title: name in reports.
        algorithm: by name.
        curriculum: None for that of the preset.
    """

    title: str
    algorithm: str
    curriculum: str | None = "none"


COMPARED_LIBRARIES = {
    "ours": ComparedLibrary("ours", "ppo", None),
    "ours, no curriculum": ComparedLibrary("ours, no curriculum", "ppo"),
    "cleanrl": ComparedLibrary("CleanRL's loop", "cleanrl_ppo"),
    "stable-baselines3": ComparedLibrary("Stable-Baselines3", "sb3_ppo"),
}
"""By their names in comparison files; others are named by their algorithm."""


def library_of(name: Any) -> ComparedLibrary:
    """A library by name; ValueError for an unknown one, or without the settings of `OBEYED`."""
    if name not in ALGORITHMS and LEARNERS.origin(str(name)) is None:
        one_of("contestant", name, COMPARED_LIBRARIES)
    found = COMPARED_LIBRARIES.get(name, ComparedLibrary(str(name), str(name)))
    missing = {*OBEYED} - {each.name for each in fields(hyperparameter_form(found.algorithm))}
    check(not missing, f"contestant {name!r} has no setting {', '.join(sorted(missing))}; add it")
    return found


@dataclass(frozen=True)
class LibraryRunSettings(Settings):
    """The settings of a run.

    Attributes:
        task: the task to learn.
        hyper: of the learner: the defaults of the library, overridden by the study file.
        contestant: the name of the library.
        library: its package with the version.
        seed: of games, weights and sampled actions.
        seconds, frames: the budget, one of the two.
        clock: in which seconds are measured: wall, or processor (time of this process; equal on an
            idle machine).
        evaluations: evenly spaced over the budget; with several two more are at 1/4 and 1/2 of the
            first interval.
        curriculum_settings, init_from: there is no curriculum, and weights are new.
    """

    curriculum_settings: ClassVar[CurriculumSettings] = CurriculumSettings()
    init_from: ClassVar[None] = None

    task: TaskSettings = field(default_factory=TaskSettings)
    hyper: PPOSettings = field(default_factory=PPOSettings)
    contestant: str = "ours"
    library: str = ""
    seed: Annotated[int, SEED] = 0
    seconds: float | None = None
    frames: int | None = None
    clock: Annotated[str, choice(*CLOCKS)] = "wall"
    evaluations: Annotated[int, at_least(1)] = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        check_budget(self.seconds, self.frames)

    @property
    def marks(self) -> list[float]:
        """The shares of the budget at which policies are evaluated."""
        even = evenly(self.evaluations)
        return [even[0] / 4, even[0] / 2, *even] if len(even) > 1 else even


def library_settings_of(**flat: Any) -> LibraryRunSettings:
    """Settings by name: of the run, of the task, and those of `OBEYED`; validated.

    Raises:
        ValueError: an unknown name, a value of a wrong type, or a task whose optimum is not known.
        ImportError: the library is not installed.
    """
    flat = plain_settings(flat)
    flat.pop("threads", None)  # always one
    own = {f.name for f in fields(LibraryRunSettings)} - {"task", "hyper", "library"}
    of_task = [f.name for f in fields(TaskSettings)]
    names = [*sorted(own), *of_task, *OBEYED]
    check(
        "game" not in flat,
        f"game={flat.get('game')!r}: libraries are compared in mazes; use pursuit sweep or ablate",
    )
    for name in flat:
        check(name in names, unknown("setting of a contestant", name, names))
    found = library_of(flat.get("contestant"))
    check("maze" in flat, "a task has no maze; give one in its settings")
    task = {name: value for name, value in flat.items() if name in of_task}
    drawn = {name: value for name, value in flat.items() if name in OBEYED}
    where, remedy = "settings of a contestant", "correct that line"
    learned = read_as(TaskSettings, task, where, remedy)
    check_task(learned)
    plain = {name: value for name, value in flat.items() if name in own}
    plain |= {"task": asdict(learned), "library": entry(found.algorithm).library}
    try:
        plain["hyper"] = asdict(hyper_of(found, learned, drawn))
    except TypeError as error:  # a string instead of a number
        raise ValueError(f"{where}: a value of a wrong type ({error}); {remedy}") from None
    return read_as(LibraryRunSettings, plain, where, remedy)


def check_task(task: TaskSettings) -> None:
    """ValueError if the optimum of the task is not known, or longer episodes are better."""
    world: Any = task_world_of(task)
    several = f"maze={task.maze!r} is several mazes; give one of them, such as {task.maze}/0"
    check(len(world.task.mazes) == 1, several)
    contest = world.contest(2)
    check(
        contest.optimal() is not None and contest.measure == BY_STEPS,
        f"{world.agent} of {task.task} in {task.maze}: a comparison needs a known optimum, and "
        "an agent that minimises episode length; use a runner with up to "
        f"{MAX_EXACT_GOALS} goals, or a chaser of one evader",
    )


def hyper_of(found: ComparedLibrary, task: TaskSettings, drawn: Table) -> PPOSettings:
    """The defaults of a library, overridden by the drawn settings.

    A minibatch is at most one rollout. A drawn discount is constant.
    """
    values, base = dict(drawn), tuned(found.algorithm, task.profile())
    if not isinstance(base, PPOSettings):
        base = PPOSettings(shared=False, **{name: getattr(base, name) for name in OBEYED})
    if "gamma" in values:
        values["gamma_end"] = None
    frames = values.get("num_games", base.num_games)
    frames *= values.get("rollout_steps", base.rollout_steps)
    values["minibatch_size"] = min(values.get("minibatch_size", base.minibatch_size), frames)
    return replace(base, **values)


def ordinary(settings: LibraryRunSettings) -> AgentSettings:
    """The settings of the same run by `pursuit train`; libraries observe one-hot vectors."""
    found, own = library_of(settings.contestant), settings.hyper
    form, profile = hyperparameter_form(found.algorithm), settings.task.profile()
    how = curriculum_for(found.algorithm, profile, curriculum=found.curriculum)
    return TrainSettings(
        settings.task,
        own if form is PPOSettings else form(**{name: getattr(own, name) for name in OBEYED}),
        how[1],
        found.algorithm,
        how[0],
        "one_hot" if entry(found.algorithm).own_loop else "auto",
        **{name: getattr(settings, name) for name in ("seconds", "frames", "clock", "seed")},
        threads=1,
    )


# -- a run -----------------------------------------------------------------------------------------


def library_parts(settings: LibraryRunSettings) -> tuple[LibraryRunSettings, Parts]:
    """The settings and the parts of a run; ValueError if its task cannot be compared."""
    check_task(settings.task)
    return settings, build_parts(parts_of, ordinary(settings))


class ComparedAgent(SingleAgent):
    """The learner of a library: greedy and sampled policies are evaluated, both clocks measured.

    Attributes:
        name: of the library.
        spent: seconds of rollouts and updates by each clock, without compilation.
    """

    kind: ClassVar[str] = LIBRARY_RUN

    def __init__(self, name: str, parts: Parts, folder: Path, state: Plain | None = None) -> None:
        self.name = name
        super().__init__(parts, "greedy", state, load_config(folder).final.episodes)
        torch.manual_seed(parts.build.seed)
        self.spent = dict.fromkeys(CLOCKS, 0.0) if state is None else dict(state["spent"])

    def iterate(self, clock: Clock) -> dict[str, float]:
        """As of `SingleAgent`."""
        began = {name: now_without_compilation(name) for name in CLOCKS}
        figures = super().iterate(clock)
        for name in CLOCKS:
            self.spent[name] += now_without_compilation(name) - began[name]
        return figures

    def evaluate(self) -> dict[str, float]:
        """The gaps of the current policy, greedy and sampled, and the steps of the better one."""
        row, scores = {f"{clock}_seconds": spent for clock, spent in self.spent.items()}, {}
        for name, success in (("greedy", "greedy_success"), ("sampled", "sampled_success")):
            scores[name] = self.contest.score(name, self.learner.policy(name == "greedy"))
            gap = optimality_gap(scores[name], self.optimum)
            assert gap is not None  # see `check_task`
            row |= {name: gap, success: scores[name].success_rate}
        better = scores[min(scores, key=lambda name: row[name])]
        row |= {"mean_steps": better.mean_steps, "success_rate": better.success_rate}
        return row | {"optimality_gap": row[better.name]}

    def results(self, episodes: int) -> Plain:
        """The last evaluation."""
        assert self.optimum is not None
        return {
            "task": self.parts.settings.task.task,
            "maze": self.parts.seat.task.mazes[0].name,
            "algorithm": self.name,
            "seed": self.parts.build.seed,
            "evaluation": {**self.evaluate(), "optimal_steps": self.optimum.mean_steps},
        }

    def state_dict(self) -> Plain:
        """As of `SingleAgent`, with the seconds."""
        return {**super().state_dict(), "spent": self.spent}


def run_of(
    given: tuple[LibraryRunSettings, Parts], folder: Path, state: Plain | None
) -> Run[ComparedAgent]:
    """The run in its folder, after an iteration and an evaluation of a learner that is discarded:
    they compile and import. It ends before the iteration that would exceed the budget."""
    settings, parts = given
    agent = partial(ComparedAgent, settings.contestant)
    warm = agent(library_parts(replace(settings, seed=WARM_UP_SEED))[1], folder)
    budget = Budget(settings.seconds, settings.frames, 1, settings.clock, within=True)
    warm.iterate(Run(warm, folder, budget))
    warm.brief().evaluate()
    warm.close()
    prepare_torch(1, settings.seed)
    return build_run(agent, parts, folder, state, budget, settings.marks)


KINDS[LIBRARY_RUN] = Kind(
    LibraryRunSettings,
    library_settings_of,
    lambda plain, where: read_as(LibraryRunSettings, plain, where, RESTORE),
    library_parts,
    run_of,
    "pursuit compare",
    (),
)
