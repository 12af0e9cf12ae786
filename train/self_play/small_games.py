"""Self-play in small games: every player learns, measured by exact NashConv."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripted_agents.games.agents import UNIFORM
from scripted_agents.games.episodes import play_of, return_range
from scripted_agents.games.simulator import GameTask
from scripted_agents.games.solve import nash_conv, returns_of
from train.evaluation.scores import Measure
from train.files import Plain
from train.self_play.mixing import MOST_SOLVED, known_mixed_share
from train.self_play.mixtures import value_in
from train.self_play.parts import SelfPlayParts
from train.self_play.trainee import SelfPlay
from train.settings.task import GAME
from train.tensors import State

Tables = dict[str, NDArray[np.float64]]


def exact_row(task: GameTask, tables: Mapping[str, Any], discount: float) -> dict[str, float]:
    """NashConv of the policies of all players, returns, gains of best responses, and steps; in a
    small zero-sum game of two also its value and the exploitability of each."""
    game, roles = task.game, task.agent_names
    found = nash_conv(game, tables, discount, task.horizon(discount))
    row = {"nash_conv": found.nash_conv}
    row |= {f"{role}_return": found.returns[role] for role in roles}
    row |= {f"{role}_gain": found.gains[role] for role in roles}
    if game.zero_sum and len(game.choices) <= MOST_SOLVED:
        (first, second), value = roles, value_in(task, discount)
        row["game_value"] = value
        row[f"{first}_exploitability"] = found.best[second] + value
        row[f"{second}_exploitability"] = found.best[first] - value
    row["steps"] = play_of(game, tables, task.max_steps).steps
    return row


def described(task: GameTask, discount: float) -> Plain:
    """The game of results: its name, size, players, the range of the returns of the first, and in a
    zero-sum game of two whose value is computed how much an equilibrium mixes."""
    game, horizon = task.game, task.horizon(discount)
    low, high = return_range(game, game.players[0], discount, horizon)
    found = {"payoff_range": high - low, "mixed_share": known_mixed_share(task, discount)}
    return {
        "task": GAME,
        "game": task.name,
        "maze": None,
        "states": game.num_states,
        "players": list(task.agent_names),
        "zero_sum": game.zero_sum,
        **found,
    }


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

    def _objective(self) -> Measure:
        return Measure("nash_conv", "return")

    def _exact(self, tables: Mapping[str, Any]) -> tuple[float, ...]:
        """The expected return of every player."""
        game, discount = self.task.game, self.parts.discount
        found = returns_of(game, tables, discount, self.task.horizon(discount))
        return tuple((game.start @ found).tolist())

    def payoff(self, one: Any, two: Any) -> float:
        """The return of the second player."""
        pair = zip(self.parts.roles, (one, two), strict=True)
        return self._exact({role: policy.table(self.task) for role, policy in pair})[1]

    def nash_conv_of(self, pair: Mapping[str, Any]) -> float:
        """As of `SelfPlay`."""
        tables = {role: policy.table(self.task) for role, policy in pair.items()}
        discount, horizon = self.parts.discount, self.task.horizon(self.parts.discount)
        return nash_conv(self.task.game, tables, discount, horizon).nash_conv

    def tables(self) -> Tables:
        """The tables of the policies that are evaluated."""
        policies: dict[str, Any] = {role: self.policy(role) for role in self.parts.roles}
        return {role: policy.table(self.task) for role, policy in policies.items()}

    def evaluate(self, episodes: int = 300, most: int = 0) -> dict[str, float]:
        """Exact NashConv, the gain of each best response, and returns, also against uniform play.

        In a zero-sum game of two also the value of the game and the exploitability of each.
        """
        roles, tables = self.parts.roles, self.tables()
        row = exact_row(self.task, tables, self.parts.discount)
        others = self.scripted_tables(UNIFORM)
        for number, role in enumerate(roles):
            if role in self.sides:
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

    def results(self, episodes: int) -> Plain:
        """NashConv, returns of all pairs of learned and named policies, and the pools; in zero-sum
        games of two also NashConv of mixtures of snapshots (`snapshot_results`)."""
        dry = self.limits.is_dry_run
        evaluation = dict(self.last) if dry and self.last else self.evaluate()
        played = {"returns": self.all_returns()}
        content = self.content(described(self.task, self.parts.discount), evaluation, played)
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


def self_play_run(parts: SelfPlayParts, folder: Path, state: State | None = None) -> SelfPlay:
    """The trainee of self-play in mazes or in a small game; arguments and errors are those of
    `SelfPlay`."""
    form = SmallGamePlay if isinstance(parts.task, GameTask) else SelfPlay
    return form(parts, folder, state)
