"""The door: the settings of a run become its parts, once, from top to bottom, and are checked here.

Below it nobody knows the settings of a run: a learner gets its own and an environment, a teacher
its plan, a contest its task and opponents.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

from train.algorithms.registry import Algorithm, Build, entry
from train.evaluation.suite_contest import SuiteContest
from train.networks.policy import NO_WALLS
from train.runs.saved import player_of, unchecked_settings
from train.runs.sizes import check_memory
from train.runs.threads import uses_bfloat16
from train.runs.worlds import GridWorld, World, world_of
from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.checks import check, evaluation_seed
from train.settings.off_policy import ReplaySettings
from train.settings.run import SHARED_OUT, TrainSettings
from train.settings.task import AnyTask, in_maze
from train.teaching.plan import Plan, check_learner, plan_lessons
from train.teaching.teacher import Teacher


@dataclass(frozen=True)
class Parts:
    """What a run is made of.

    Attributes:
        world: what is played, and by whom else.
        plan: what is taught when; None without a curriculum.
        seat: whose policy is learned, in the training games.
        algorithm, hyper: what it learns by, and the settings of that.
        build: how the learner is to be built on this machine.
        processes: that learn together; task and settings are then of the games of this one.
        rank: of this process among them, from 0 on.
    """

    world: World
    plan: Plan | None
    seat: Any
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build
    processes: int = 1
    rank: int = 0

    def games(self) -> tuple[Any, Teacher | None]:
        """The training games as a TorchRL environment, and who teaches in them."""
        games = (self.hyper.num_games, self.build.seed, self.plan)
        first_game = self.rank * self.hyper.num_games
        env, teacher = self.world.games(self.seat, *games, first_game)
        if teacher is not None and self.rank:
            teacher.rng = teacher.rng.spawn(self.rank)[-1]  # lessons of its own
        return env, teacher

    def contest(self, episodes: int) -> Any:
        """What it is judged by."""
        return self.world.contest(episodes)


def parts_of(settings: TrainSettings[Any], rank: int = 0) -> Parts:
    """The parts of a run, or of the process of this rank among those of one.

    Raises:
        ValueError: settings that make no game, an agent that does not play in it, an opponent that
            is none, or what the algorithm or the curriculum cannot do.
    """
    algorithm = entry(settings.algorithm)
    seat = player_of(settings)
    algorithm.check_actions(seat)
    check_algorithm(settings, algorithm)
    check(
        not (isinstance(settings.hyper, PPOSettings) and settings.hyper.central_critic),
        "central_critic=True is for several agents that learn at once; use it in "
        "`pursuit self-play`",
    )
    if isinstance(settings.hyper, ReplaySettings):
        starts = settings.hyper.learning_starts
        if settings.frames is not None and settings.frames <= starts:
            warnings.warn(
                f"frames={settings.frames} and learning_starts={starts}: it ends before anything "
                "is learned; take more frames, or lower learning_starts",
                stacklevel=2,
            )
    world = world_of(settings.task)
    check_mazes(settings, algorithm, world)
    plan = plan_lessons(settings.curriculum, settings.lessons, world.ground, settings.seed)
    if plan is not None:
        check_learner(plan, algorithm)
        check(
            plan.exam is None or (settings.hyper.recurrent is None and settings.frame_stack == 1),
            f"curriculum={settings.curriculum!r} judges mazes by what a policy does in every cell, "
            "and one that remembers does not go by that; leave out recurrent and frame_stack, or "
            "take level-replay",
        )
    algorithm.check_player(settings.hyper, seat)
    algorithm.check_memory(settings.hyper, seat)
    check_memory(settings.hyper, seat)
    build = build_of(settings)
    hyper: Any = settings.hyper
    if settings.processes > 1:  # the games of both are those of one process
        share = {name: getattr(hyper, name) // settings.processes for name in SHARED_OUT}
        hyper = replace(hyper, **share)
    return Parts(world, plan, seat, algorithm, hyper, build, settings.processes, rank)


def settings_of(**flat: Any) -> TrainSettings[Any]:
    """Settings by their names on the command line, with `preset` for what is left out; checked.

    `settings_of(algorithm="dqn", maze="7x7", task="maze", seconds=60, learning_rate=1e-3)`.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    settings = unchecked_settings(**flat)
    parts_of(settings)
    return settings


def build_of(settings: TrainSettings[Any]) -> Build:
    """How a learner is to be built on this machine."""
    bfloat16 = uses_bfloat16(settings.precision, settings.device)
    fused = settings.fused == "auto"
    return Build(settings.device, bfloat16, settings.first_layer, settings.seed, fused)


def check_mazes(settings: TrainSettings[Any], algorithm: Algorithm, world: World) -> None:
    """ValueError where an algorithm cannot learn in several mazes; a warning where what is observed
    does not tell them apart."""
    if len(getattr(world.task, "mazes", ())) < 2:
        return
    check(
        not algorithm.one_maze,
        f"algorithm={algorithm.name!r} has a table for one maze, and {settings.task.label} has "
        f"{len(world.task.mazes)}; take a learner with a network",
    )
    if settings.observation in NO_WALLS:
        warnings.warn(
            f"observation={settings.observation!r} shows no walls, so {len(world.task.mazes)} "
            "mazes look alike; take window:R, planes or walls",
            stacklevel=3,
        )


def check_algorithm(settings: TrainSettings[Any], algorithm: Algorithm) -> None:
    """ValueError where the settings ask of the algorithm what it cannot do."""
    check(
        type(settings.hyper) is algorithm.settings,
        f"algorithm={algorithm.name!r} with settings of {type(settings.hyper).__name__}",
    )
    algorithm.check(
        observation=settings.observation,
        device=settings.device,
        greedy=settings.evaluate == "greedy",
    )


def suite_contest_of(
    settings: AnyTask, episodes: int, seed: int = 0, exact: bool = False
) -> SuiteContest:
    """The same as a contest over many mazes, of however many there are: `contest_of`.

    Raises:
        ValueError: a task without mazes.
    """
    world = GridWorld(in_maze(settings, "a suite of mazes"))
    opponents = (world.task, world.agent, world.opponents)
    return SuiteContest(*opponents, episodes, evaluation_seed(seed), exact)


def contest_of(settings: AnyTask, episodes: int, seed: int = 0) -> Any:
    """What a policy is judged by in a task, without any run; `seed` is one of the evaluation's."""
    return world_of(settings).contest(episodes, evaluation_seed(seed))
