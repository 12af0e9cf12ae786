"""Matches of one policy for all chasers and one for all evaders, exact or sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Rewards, Task
from scripted_agents import (
    evaluate_joint,
    mean_over_starts,
    mean_over_team_starts,
    team_survival,
    why_not_team_chase,
)
from scripted_agents.exact.joint.solver import lengths_of, quantities_of
from scripted_agents.exact.limits import MAX_EXACT_WORK, MAX_FINAL_WORK
from scripted_agents.exact.references import MATCHES, Question, is_table_duel, solution_of
from train.evaluation.games import (
    Escapes,
    all_caught,
    evader_indices,
    half_width,
    mean_steps,
    play_out,
    stepper,
    steps_and_ended,
    table_in,
)
from train.files import Plain
from train.settings.checks import EVALUATION_SEED


@dataclass(frozen=True)
class Matchup:
    """The result of a match.

    Attributes:
        steps: expected steps until the last capture, truncated at `max_steps`.
        ci95: half width of its 95 % confidence interval; 0 if exact.
        caught: share of games in which all evaders were caught in time; with exits, the share of
            evaders that were.
        games: number of sampled games; 0 if exact.
        escaped: share of evaders that escaped; None without exits.
        outcome: mean number of captures minus escapes; None without exits.
    """

    steps: float
    ci95: float
    caught: float
    games: int
    escaped: float | None = None
    outcome: float | None = None

    def plain(self) -> Plain:
        """As a dict, without what there is only with exits."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @property
    def shown(self) -> float:
        """The measure that is shown: the steps; with exits the outcome."""
        return self.steps if self.outcome is None else self.outcome

    @property
    def payoff(self) -> float:
        """What evaders maximise: the steps; with exits the escapes minus the captures."""
        return self.steps if self.outcome is None else -self.outcome


def play_pair(
    task: Task, chaser: Policy, evader: Policy, episodes: int, seed: int = EVALUATION_SEED
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Play episodes: lengths [episodes], and whether all evaders were caught [episodes]."""
    return _played(task, chaser, evader, episodes, seed)[:2]


def pair_payoffs(
    task: Task, chaser: Policy, evader: Policy, episodes: int, seed: int = EVALUATION_SEED
) -> NDArray[np.int64]:
    """[episodes] the `Matchup.payoff` of each of these episodes."""
    lengths, _, escapes = _played(task, chaser, evader, episodes, seed)
    if not task.most_exits:
        return lengths
    return (escapes.seen.sum(axis=1) - escapes.captured.sum(axis=1)).astype(np.int64)


def _played(
    task: Task, chaser: Policy, evader: Policy, episodes: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_], Escapes]:
    simulator = Simulator(task, episodes, seed, auto_restart=False)
    policies = [chaser if role == "chaser" else evader for role in task.seat_roles]
    escapes = Escapes(simulator)
    lengths, caught = play_out(
        simulator,
        escapes.after(stepper(simulator, policies)),
        lambda games: games.terminated | games.truncated,
        lambda games: all_caught(games, escapes.seen),
    )
    return lengths, caught, escapes


NEGLIGIBLE = 1e-3
"""Share of the largest value that the steps after the last simulated one can add."""


def discounted_steps(
    task: Task,
    chaser: Policy,
    evader: Policy,
    discount: float,
    episodes: int = 1000,
    seed: int = EVALUATION_SEED,
) -> float:
    """The expected sum of discount**t over the steps until the game ends: the payoff of the game.

    With exits it is the `Matchup.payoff`, within the time limit. Otherwise the game has no time
    limit, as in training (truncated episodes are bootstrapped) and in exploitability. Exact for
    small duels (`is_table_duel`), and with exits for small games; otherwise the mean over
    `episodes` games, simulated until further steps are negligible.

    Args:
        task: the game; its `max_steps` is ignored.
        chaser, evader: the policies of all agents of each role.
        discount: of each step, in (0, 1).
        episodes, seed: of the sampled games.
    """
    if task.most_exits:
        return match(task, chaser, evader, episodes, MAX_EXACT_WORK).payoff
    if is_table_duel(task, chaser, evader):
        tables = table_in(task, chaser), table_in(task, evader)
        return mean_steps(task, "chaser", tables, None, discount)
    longest = replace(task, max_steps=ceil(log(NEGLIGIBLE) / log(discount)))
    lengths, _ = play_pair(longest, chaser, evader, episodes, seed)
    return float((1.0 - discount**lengths).mean() / (1.0 - discount))


def exact_match(
    task: Task, policies: Mapping[str, Policy], most: int = MAX_EXACT_WORK
) -> Matchup | None:
    """The result of a match, over all starts; None if it is not solved.

    Args:
        task: the game.
        policies: of all agents, by agent name or role.
        most: the largest size of a team chase that is solved; 0 for none.
    """
    asked = Question(task, None, policies, most)
    kind = solution_of(asked, MATCHES).kind
    if kind == "none":
        return None
    if kind == "duel":
        chaser, evader = (table_in(task, policy) for policy in asked.fixed)
        mean, caught = (
            mean_over_starts(values, task.mazes[0], task.min_start_distance)
            for values in steps_and_ended(task, "chaser", (chaser, evader))
        )
    elif why_not_team_chase(task) is not None:
        return exact_joint_match(task, policies)
    else:
        steps, late = team_survival(task, policies, task.max_steps)
        mean, caught = (mean_over_team_starts(values, task) for values in (steps, 1.0 - late))
    return Matchup(mean, 0.0, caught, 0)


COUNTS = {"chaser": Rewards(capture=1.0, per_evader=True), "evader": Rewards(escape=1.0)}
"""Rewards that count the captures, as the return of every chaser, and the escapes."""


def exact_joint_match(task: Task, policies: Mapping[str, Policy]) -> Matchup:
    """The result in any chase without goals, over all starts; policies as of `evaluate_joint`."""
    if not task.most_exits:
        states, values = quantities_of(task, policies, lengths_of(task), task.max_steps, 1.0)
        length, ended = states.mean_over_starts(values).tolist()
        return Matchup(length, 0.0, ended, 0)
    agents = ("chaser_0", *task.agent_names[evader_indices(task)])
    found = evaluate_joint(replace(task, rewards=COUNTS), policies, task.max_steps, agents=agents)
    caught, *escaped = (found.returns[name] / task.num_evaders for name in agents)
    left = sum(escaped)
    return Matchup(found.length, 0.0, caught, 0, left, task.num_evaders * (caught - left))


def match(
    task: Task,
    chaser: Policy,
    evader: Policy,
    episodes: int = 1000,
    most: int = MAX_FINAL_WORK,
    seed: int = EVALUATION_SEED,
) -> Matchup:
    """The result of a match: exact if it can be solved, otherwise the mean over `episodes` games.

    Args:
        task: the game.
        chaser, evader: the policies of all agents of each role.
        episodes: number of games, if they are sampled.
        most: the largest size of a team chase that is solved; 0 for none.
        seed: of sampled games.
    """
    found = exact_match(task, {"chaser": chaser, "evader": evader}, most)
    if found is not None:
        return found
    lengths, caught, escapes = _played(task, chaser, evader, episodes, seed)
    mean, ci95 = float(lengths.mean()), half_width(lengths)
    if not task.most_exits:
        return Matchup(mean, ci95, float(caught.mean()), episodes)
    share, escaped = float(escapes.captured.mean()), float(escapes.seen.mean())
    outcome = task.num_evaders * (share - escaped)
    return Matchup(mean, ci95, share, episodes, escaped, outcome)
