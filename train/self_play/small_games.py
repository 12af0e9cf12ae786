"""Self-play in small games: every player learns, measured by exact NashConv."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripted_agents.games.agents import UNIFORM
from scripted_agents.games.episodes import play_of
from scripted_agents.games.simulator import GameTask
from scripted_agents.games.solve import equilibrium, nash_conv, returns_of
from train.files import Plain
from train.runs.forms import Objective
from train.runs.loop import BRIEF_STEPS
from train.self_play.metrics import DRY_RUN
from train.self_play.parts import SelfPlayParts
from train.self_play.trainee import SelfPlay
from train.settings.self_play import SmallGameSelfPlay
from train.tensors import State

MOST_SOLVED = 100_000
"""Joint actions of a zero-sum game up to which its value is computed: seconds."""

Tables = dict[str, NDArray[np.float64]]


def horizon_of(task: GameTask, discount: float) -> int | None:
    """The horizon of exact results of self-play; None with a discount."""
    return task.max_steps if discount == 1.0 else None


def value_of(task: GameTask, discount: float) -> float | None:
    """The value of a game for the first player; None unless it is zero-sum and small."""
    game = task.game
    if not game.zero_sum or len(game.choices) > MOST_SOLVED:
        return None
    return equilibrium(game, discount, horizon_of(task, discount)).mean_over_starts


def exact_row(
    task: GameTask, tables: Mapping[str, Any], discount: float, value: float | None
) -> dict[str, float]:
    """NashConv of the policies of all players, returns, gains of best responses, and steps; with
    the `value` of a zero-sum game of two also the exploitability of each."""
    roles = task.agent_names
    found = nash_conv(task.game, tables, discount, horizon_of(task, discount))
    row = {"nash_conv": found.nash_conv}
    row |= {f"{role}_return": found.returns[role] for role in roles}
    row |= {f"{role}_gain": found.gains[role] for role in roles}
    if value is not None:
        first, second = roles
        row["game_value"] = value
        row[f"{first}_exploitability"] = found.best[second] + value
        row[f"{second}_exploitability"] = found.best[first] - value
    row["steps"] = play_of(task.game, tables, task.max_steps).steps
    return row


class SmallGamePlay(SelfPlay):
    """The players of a small game learn against each other; a `Trainee`.

    Returns have the discount of the learners; without discount (1) they are those within
    `max_steps`, and best responses may depend on time.
    """

    task: GameTask

    def line(self) -> str:
        """As of `SelfPlay`."""
        game = self.task.game
        return (
            f"game {self.task.name} ({game.num_states:,} states, {len(game.choices):,} joint "
            f"actions), {', '.join(self.parts.roles)}"
        )

    @property
    def horizon(self) -> int | None:
        """Of exact results; None with a discount."""
        return horizon_of(self.task, self.parts.discount)

    def _objective(self) -> Objective:
        return Objective("nash_conv", "return", less_is_better=True)

    def _exact(self, tables: Mapping[str, Any]) -> tuple[float, ...]:
        """The expected return of every player."""
        game = self.task.game
        found = returns_of(game, tables, self.parts.discount, self.horizon)
        return tuple((game.start @ found).tolist())

    def payoff(self, one: Any, two: Any) -> float:
        """The return of the second player."""
        pair = zip(self.parts.roles, (one, two), strict=True)
        return self._exact({role: policy.table(self.task) for role, policy in pair})[1]

    def tables(self) -> Tables:
        """The tables of the policies that are evaluated."""
        policies: dict[str, Any] = {role: self.policy(role) for role in self.parts.roles}
        return {role: policy.table(self.task) for role, policy in policies.items()}

    @cached_property
    def game_value(self) -> float | None:
        """The value of the game for the first player; None unless it is zero-sum and small."""
        return value_of(self.task, self.parts.discount)

    def evaluate(self, episodes: int = 300, most: int = 0) -> dict[str, float]:
        """Exact NashConv, the gain of each best response, and returns, also against uniform play.

        In a zero-sum game of two also the value of the game and the exploitability of each.
        """
        roles, tables = self.parts.roles, self.tables()
        row = exact_row(self.task, tables, self.parts.discount, self.game_value)
        for number, role in enumerate(roles):
            if role in self.sides:
                others = self.scripted_tables(UNIFORM)
                row[f"{role}_vs_{UNIFORM}"] = self._exact({**others, role: tables[role]})[number]
        self.last = row
        return row

    def scripted_tables(self, name: str) -> Tables:
        """The tables of a named policy of every player."""
        scripted: dict[Any, Any] = self.parts.scripted
        return {role: scripted[name, role].table(self.task) for role in self.parts.roles}

    def log_fields(self, row: dict[str, float]) -> list[str]:
        """NashConv, the return of every player, and the steps of an episode."""
        parts = [f"NashConv {row['nash_conv']:z8.4f}"]
        parts += [f"{role} {row[f'{role}_return']:z7.3f}" for role in self.parts.roles]
        return [*parts, f"{row['steps']:6.1f} steps"]

    def results(self, interrupted: bool, episodes: int) -> Plain:
        """NashConv, returns of all pairs of learned and named policies, and the pools; in zero-sum
        games of two also NashConv of mixtures of snapshots (`snapshot_results`)."""
        settings, sides = self.settings, [side.parts for side in self.sides.values()]
        assert isinstance(settings, SmallGameSelfPlay)
        dry = self.limits.is_dry_run
        evaluation = dict(self.last) if dry and self.last else self.evaluate()
        content = {
            "task": settings.task.task,
            "game": settings.task.game,
            "maze": None,
            "states": self.task.game.num_states,
            "players": list(self.parts.roles),
            "zero_sum": self.task.game.zero_sum,
            "algorithm": ", ".join(side.algorithm.name for side in sides),
            "sampling": settings.sampling,
            "seed": settings.seed,
            "discount": self.parts.discount,
            "precision": sides[0].build.precision,
            "update": ", ".join(
                getattr(side.learner, "update_form", "torch") for side in self.sides.values()
            ),
            "evaluation": evaluation,
            "returns": self.all_returns(),
            "pools": {role: pool.described() for role, pool in self.pools.items()},
            "mixtures": self.mixtures,
        }
        if not interrupted:
            self.add_snapshot_results(content, {role: self.policy(role) for role in self.pools})
        return content

    def all_returns(self) -> list[Plain]:
        """For each player the returns of its policies against each named policy of all others.

        Rows: "player", "policy" (learned, frozen, or a name), "against" (learned or a name), and
        "return", exact.
        """
        learned, rows = self.tables(), list[Plain]()
        scripted: list[str] = [*dict.fromkeys(name for name, _ in self.parts.scripted)]
        named = {name: self.scripted_tables(name) for name in scripted}
        for number, role in enumerate(self.parts.roles):
            own = "learned" if role in self.sides else "frozen"
            for policy, mine in {own: learned, **named}.items():
                for against, theirs in {"learned": learned, **named}.items():
                    value = self._exact({**theirs, role: mine[role]})[number]
                    rows.append(
                        {"player": role, "policy": policy, "against": against, "return": value}
                    )
        return rows

    def brief(self) -> SmallGamePlay:
        """As `Trainee`."""
        small = copy(self)
        small.task = replace(self.task, max_steps=min(self.task.max_steps, BRIEF_STEPS))
        small.limits, small.tell = DRY_RUN, lambda what, share: None
        return small


def self_play_run(parts: SelfPlayParts, folder: Path, state: State | None = None) -> SelfPlay:
    """The trainee of self-play in mazes or in a small game; arguments and errors are those of
    `SelfPlay`."""
    form = SmallGamePlay if isinstance(parts.task, GameTask) else SelfPlay
    return form(parts, folder, state)
