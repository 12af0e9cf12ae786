"""Validation of the settings of a run, and construction of its parts.

Parts do not depend on all settings: a learner gets its hyperparameters and an environment, a
teacher gets its plan, and a contest gets its task and opponents.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Any

from pursuit.memory import check_memory
from pursuit.observations.custom import without_id
from pursuit.validation import check
from train.algorithms.registry import Algorithm, Build, entry
from train.families.family import TaskWorld
from train.machine import uses_bfloat16
from train.networks.policy import NO_WALLS
from train.networks.seat import Seat
from train.runs.imitation import expert_of
from train.runs.logs import logs_of
from train.runs.saved import check_source, learning_seat, unchecked_settings
from train.runs.worlds import contest_of as contest_of
from train.runs.worlds import task_world_of
from train.settings.algorithms import Hyperparameters
from train.settings.common import check_min_probability
from train.settings.off_policy import ReplaySettings
from train.settings.run import SHARED_OUT, AgentSettings
from train.teaching.plan import Plan, plan_curriculum
from train.teaching.teacher import Teacher

if TYPE_CHECKING:  # slow to import
    from train.environments.batch_env import BatchEnv
    from train.environments.vector_env import LearnerVectorEnv

FEWEST_ITERATIONS, FEWEST_EPISODES = 10, 3
"""A budget for fewer iterations of the learner, or episodes of full length, is warned of."""


@dataclass(frozen=True)
class Parts:
    """The parts of a run.

    Attributes:
        settings: of the run.
        world: the task with its opponents.
        plan: of the curriculum; None without one.
        seat: the learning agent in the training games.
        algorithm, hyper: the algorithm and its hyperparameters.
        build: options of building the learner on this machine.
        rank: of the process in data parallel training (`data_parallel.py`), from 0.
    """

    settings: AgentSettings
    world: TaskWorld
    plan: Plan | None
    seat: Seat
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build
    rank: int = 0

    def games(self, frames: int = 0) -> tuple[BatchEnv | LearnerVectorEnv, Teacher | None]:
        """The training environment of a learner with these frames, and the teacher in it."""
        games = self.hyper.num_games
        expert = expert_of(self.settings, self.world, self.seat, self.algorithm, frames)
        if self.algorithm.own_loop:
            own = (games, self.build.seed, self.hyper.last_gamma)
            return self.world.vector_games(self.seat, *own), None
        how = (self.build.seed, self.plan, self.rank * games, self.hyper.last_gamma)
        env, teacher = self.world.games(self.algorithm.env_form, self.seat, games, *how)
        env.expert = expert
        if teacher is not None and self.rank:
            teacher.rng = teacher.rng.spawn(self.rank)[-1]  # independent samples of the curriculum
        return env, teacher


def parts_of(settings: AgentSettings, rank: int = 0) -> Parts:
    """The parts of a run; in data parallel training those of the process with this rank.

    Raises:
        ValueError: settings that are not valid for the task, the agent, the opponent, the
            algorithm or the curriculum.
    """
    algorithm, hyper, seat = entry(settings.algorithm), settings.hyper, learning_seat(settings)
    logs_of(settings.log)
    check(
        type(hyper) is algorithm.settings,
        f"algorithm={algorithm.name!r} with {type(hyper).__name__}; give "
        f"{algorithm.settings.__name__}",
    )
    algorithm.check(hyper, seat, settings.device, settings.evaluate == "greedy")
    if algorithm.own_loop:
        check_own_loop(settings)
    if not seat.continuous:
        check_min_probability(settings.min_probability, seat.num_actions)
    if (frames := settings.frames) is not None:
        if isinstance(hyper, ReplaySettings) and frames <= hyper.learning_starts:
            warnings.warn(
                f"frames={frames} with learning_starts={hyper.learning_starts}: the run ends "
                "before the first gradient step; use more frames, or a lower learning_starts",
                stacklevel=2,
            )
        games, steps = hyper.num_games, seat.task.max_steps
        iterations, episodes = frames / (games * hyper.rollout_steps), frames / (games * steps)
        if iterations < FEWEST_ITERATIONS or episodes < FEWEST_EPISODES:
            warnings.warn(
                f"frames={frames} with num_games={games}: {iterations:.3g} iterations of "
                f"the learner, and {episodes:.3g} episodes of max_steps={steps} in each game; give "
                f"{FEWEST_ITERATIONS} and {FEWEST_EPISODES} by more frames or a lower num_games",
                stacklevel=2,
            )
    world = task_world_of(settings.task, algorithm.whole_role)
    if algorithm.whole_role:
        world.contest(2)  # refuses what has no result as a team
    mazes = len(getattr(world.task, "mazes", ()))
    if mazes > 1 and without_id(settings.observation) in NO_WALLS:
        warnings.warn(
            f"observation={settings.observation!r} does not contain walls, so {mazes} mazes are "
            "indistinguishable; use window:R, planes or walls",
            stacklevel=2,
        )
    plan = plan_curriculum(
        settings.curriculum, settings.curriculum_settings, world.context, settings.seed
    )
    if plan is not None:
        check(
            algorithm.has_advantages or not plan.settings.needs_advantages,
            f"level_score=value_loss needs advantages, which algorithm={algorithm.name!r} does not "
            "have; use regret or learnability, or ppo or a2c",
        )
        check(
            plan.scorer is None or (hyper.recurrent is None and settings.frame_stack == 1),
            f"curriculum={settings.curriculum!r} evaluates the policy in every cell, which needs a "
            "policy without memory; leave out recurrent and frame_stack, or use level-replay",
        )
    check_sizes(hyper, seat)
    if settings.processes > 1:
        shares = {name: getattr(hyper, name) // settings.processes for name in SHARED_OUT}
        hyper = replace(hyper, **shares)
    return Parts(settings, world, plan, seat, algorithm, hyper, build_of(settings), rank)


def check_own_loop(settings: AgentSettings) -> None:
    """ValueError for settings that an algorithm with its own loop and network does not support."""
    given = {
        "curriculum": ("none",),
        "network": ("auto", "mlp", "flat"),
        "frame_stack": (1,),
        "device": ("cpu",),
        "precision": ("auto", "float32"),
    }
    for name, able in given.items():
        value = getattr(settings, name)
        check(
            value in able,
            f"{name}={value!r} is not supported by {settings.algorithm}, which brings its own loop "
            "and network; leave it out, or use ppo",
        )


def check_sizes(hyper: Hyperparameters, seat: Seat) -> None:
    """Check that rollouts, replay buffer and network fit into the free memory of this machine.

    Raises:
        ValueError: one does not; names the bytes and the setting.
    """
    observation, games = 4 * prod(seat.features.shape), hyper.num_games
    frame = 2 * observation + 32 + 4 * seat.num_actions
    steps, width = hyper.rollout_steps, hyper.width
    needs = {
        f"num_games={games} × rollout_steps={steps}": games * steps * frame,
        f"buffer_size={hyper.buffer_size}": hyper.buffer_size * frame,
        f"reservoir_size={hyper.reservoir_size}": hyper.reservoir_size * frame,
        # Each weight of the second layer also has a gradient and two moments of Adam.
        f"width={width}": 16 * width**2,
    }
    for what, needed in needs.items():
        check_memory(what, needed, "lower it")


def settings_of(**flat: Any) -> AgentSettings:
    """Settings by their names on the command line, with defaults from `preset`; validated.

    `settings_of(algorithm="dqn", maze="7x7", task="maze", seconds=60, learning_rate=1e-3)`.

    Numbers can be those of NumPy, and whole numbers floats, as 1e6.

    Args:
        **flat: settings. Their meanings and defaults stand in the output of
            `pursuit train --help-all`, also after `--task reacher`, `--algorithm NAME` and
            `--curriculum NAME`.
            The budget, one of: seconds, frames.
            The run: algorithm, preset, seed, clock, evaluate, device, precision, fused, threads,
            processes, checkpoints, init_from, imitate, imitate_frames, log.
            The network: observation, network, frame_stack, min_probability.
            A task in mazes: task, role, maze, num_chasers, num_evaders, num_runners, num_goals,
            max_steps, stay_action, move_order, start, min_start_distance, capture, n_catch,
            capture_check, exits, num_exits, collisions, slip, rewards, view_radius,
            line_of_sight, unknown_maze, mask_bumps, opponent, opponent_epsilon, opponent_policy,
            opponent_observation.
            The arm: task="reacher", joints, start, hold, tolerance, max_steps, max_turn, effort,
            discrete_actions.
            The algorithm, here PPO: num_games, rollout_steps, minibatch_size, epochs,
            learning_rate, anneal, gamma, gamma_end, gae_lambda, standardize_advantages, clip,
            kl_target, kl_coef, entropy_coef, entropy_end, value_coef, critic, max_grad_norm,
            adam_epsilon, adam_beta1, width, activation, shared, recurrent, first_std, action_std.
            The curriculum: curriculum, and the settings of that curriculum.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    settings = unchecked_settings(**flat)
    check_source(settings)
    parts = parts_of(settings)
    expert_of(settings, parts.world, parts.seat, parts.algorithm)  # refuses what has none
    return settings


def build_of(settings: AgentSettings) -> Build:
    """The options of building a learner on this machine."""
    own = entry(settings.algorithm).own_loop
    bfloat16 = not own and uses_bfloat16(settings.precision, settings.device)
    fused = settings.fused == "auto"
    return Build(settings.device, bfloat16, settings.seed, fused)
