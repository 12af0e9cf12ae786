"""The settings of a task that the rules use, and their form as arguments of kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Longs, Reals

CHASER, EVADER, RUNNER = range(3)
CELL, ADJACENT, SURROUND = range(3)
"""The capture rules, `Task.capture`."""


class Teams(NamedTuple):
    """The numbers of agents and goals; constants in kernels compiled for one task."""

    chasers: int
    evaders: int
    runners: int
    goals: int


class RewardCoefficients(NamedTuple):
    """Reward coefficients of one role; see `pursuit.tasks.rewards.Rewards`."""

    step: float
    capture: float
    goal: float
    distance: float
    on_completion: float
    per_evader: float
    escape: float
    touch: float


class Options(NamedTuple):
    """The options of the rules; see `pursuit.tasks.task.Task` for their meaning.

    capture: CELL, ADJACENT or SURROUND. n_catch: the captors that a capture needs. recheck: whether
    captures are resolved again after the evaders' moves. block: whether solid agents cannot share a
    cell. turns: whether a step is the move of one side. slips: whether moves can slip. touches:
    whether touching an evader is rewarded. exits: the number of exits.
    """

    capture: int
    n_catch: int
    recheck: bool
    block: bool
    turns: bool
    slips: bool
    touches: bool
    exits: int


PLAIN = Options(CELL, 1, True, False, False, False, False, 0)
"""The rules without options."""


class StepRules(NamedTuple):
    """The settings of a task that a step uses."""

    teams: Teams
    max_steps: int
    num_actions: int
    chasers_first: bool
    chaser: RewardCoefficients
    evader: RewardCoefficients
    runner: RewardCoefficients
    options: Options


class StartRules(NamedTuple):
    """The settings of a task that the start of an episode uses.

    fixed_exits: [mazes * exits] int64, the exits of every maze, -1 if it has fewer; empty if exits
        are drawn at the start of an episode.
    """

    teams: Teams
    at_marks: bool
    slips: bool
    exits: int
    fixed_exits: Longs


OPTIONS_AT = 8
FIXED_EXITS_AT = OPTIONS_AT + len(Options._fields)


def numbers_of(
    teams: Teams,
    max_steps: int,
    num_actions: int,
    chasers_first: bool,
    start_at_marks: bool,
    options: Options = PLAIN,
    fixed_exits: Sequence[int] = (),
) -> Longs:
    """[...] int64: the teams and the integer rules, an argument of kernels."""
    rules = (max_steps, num_actions, chasers_first, start_at_marks)
    return np.array([*teams, *rules, *options, *fixed_exits], dtype=np.int64)


@inlined
def teams_of(numbers: Longs) -> Teams:
    """The numbers of agents and goals in `numbers`, the result of `numbers_of`."""
    return Teams(numbers[0], numbers[1], numbers[2], numbers[3])


@inlined
def rewards_of(row: Reals) -> RewardCoefficients:
    """The coefficients of one role, in the order of the fields of `RewardCoefficients`."""
    return RewardCoefficients(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7])


@inlined
def options_of(numbers: Longs) -> Options:
    """The options of the rules in `numbers`, the result of `numbers_of`."""
    return Options(
        numbers[OPTIONS_AT], numbers[OPTIONS_AT + 1], numbers[OPTIONS_AT + 2] != 0,
        numbers[OPTIONS_AT + 3] != 0, numbers[OPTIONS_AT + 4] != 0, numbers[OPTIONS_AT + 5] != 0,
        numbers[OPTIONS_AT + 6] != 0, numbers[OPTIONS_AT + 7],
    )  # fmt: skip


@inlined
def no_options(numbers: Longs) -> Options:
    """The rules without options, as constants."""
    return PLAIN


@inlined
def step_rules_of(teams: Teams, numbers: Longs, coefficients: Reals, options: Options) -> StepRules:
    """The rules for these teams and options: `numbers` is the result of `numbers_of`."""
    return StepRules(
        teams, numbers[4], numbers[5], numbers[6] != 0, rewards_of(coefficients[CHASER]),
        rewards_of(coefficients[EVADER]), rewards_of(coefficients[RUNNER]), options,
    )  # fmt: skip


@inlined
def start_rules_of(numbers: Longs, options: Options) -> StartRules:
    """The rules of starts for these options: `numbers` is the result of `numbers_of`."""
    fixed_exits = numbers[FIXED_EXITS_AT:]
    return StartRules(teams_of(numbers), numbers[7] != 0, options.slips, options.exits, fixed_exits)
