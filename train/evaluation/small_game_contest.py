"""Evaluation of a player of a small game in returns, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pursuit.rendering.rendering import Drawable
from pursuit.replays.viewer.data import Builder
from scripted_agents.exact.references import SMALL_GAMES, Question, Solution, solution_of
from scripted_agents.games.agents import TableAgent, named_agent
from scripted_agents.games.episodes import play_of, play_of_response
from scripted_agents.games.rendering import scene_of
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from scripted_agents.games.solve import SmallResponse, nash_conv, respond
from scripted_agents.names import EQUILIBRIUM, UNIFORM
from train.evaluation.return_contest import ReturnContest
from train.evaluation.scores import (
    BEST_RETURN,
    UNKNOWN_GAP,
    FunctionActions,
    ObjectiveGap,
    Score,
    label_of,
)
from train.evaluation.small_game_replay import add_small_game
from train.files import Plain


@dataclass(frozen=True)
class SmallGameContest(ReturnContest):
    """Evaluation of one player of a small game against fixed policies; all scores are exact.

    The optimum is that within the time limit, so that it may depend on the time.
    """

    task: GameTask
    opponents: Mapping[str, StatePolicy]
    batch: type[GameSimulator] = field(default=GameSimulator, init=False)

    @property
    def exact_reference(self) -> Solution:
        """As `Contest`."""
        return solution_of(Question(self.task, self.agent, self.opponents), SMALL_GAMES)

    @cached_property
    def tables(self) -> dict[str, NDArray[np.float64]]:
        """The tables of the other players."""
        return {name: policy.table(self.task) for name, policy in self.opponents.items()}

    def describe(self) -> Plain:
        """The task, the game, and the learning player."""
        return {"task": "game", "role": self.agent, "maze": None, "game": self.task.name}

    def line(self) -> str:
        """As `Contest`."""
        game = self.task.game
        others = ", ".join(f"{name} {label_of(own)}" for name, own in self.opponents.items())
        return (
            f"game {self.task.name}: {self.agent} ({game.num_states:,} states, "
            f"{len(game.choices):,} joint actions), {'with ' + others if others else 'alone'}, at "
            f"most {self.task.max_steps} steps"
        )

    def score(self, name: str, policy: StatePolicy) -> Score:
        """As `Contest`, exact."""
        return self._score(name, policy.table(self.task))

    def _score(self, name: str, table: NDArray[np.float64]) -> Score:
        task = self.task
        found = play_of(task.game, {**self.tables, self.agent: table}, task.max_steps)
        mean = float(found.returns[task.seat(self.agent)])
        return Score(name, found.steps, 0.0, found.ended, self.episodes, True, mean_return=mean)

    @cached_property
    def best(self) -> SmallResponse:
        """The best response within the time limit."""
        return respond(self.task.game, self.agent, self.tables, 1.0, self.task.max_steps)

    def brief(self, steps: int) -> SmallGameContest:
        """As `Contest`."""
        return replace(self, task=replace(self.task, max_steps=steps))

    def scripted(self) -> StatePolicy:
        """As `Contest`: uniform."""
        return named_agent(UNIFORM, self.task, self.agent)

    def best_policy(self) -> StatePolicy:
        """As `Contest`: that of the first step."""
        return TableAgent(self.task, self.agent, self.best.policies[self.agent])

    def uniform_policy(self) -> StatePolicy:
        """As `Contest`: of the first step."""
        return TableAgent(self.task, self.agent, self.best.uniform[self.agent])

    def columns(self, policy: StatePolicy) -> dict[str, float]:
        """As `Contest`: how far the return is below that of the best response, and NashConv with
        the policies of the others."""
        tables = {**self.tables, self.agent: policy.table(self.task)}
        found = nash_conv(self.task.game, tables, 1.0, self.task.max_steps)
        return {"return_regret": found.gains[self.agent], "nash_conv": found.nash_conv}

    def objective_gap(self, discount: float) -> ObjectiveGap:
        """As `Contest`: the return that the best response for a discount lacks."""
        if discount <= 0.0:
            return UNKNOWN_GAP
        plan = self.best
        if discount != 1.0:
            plan = respond(self.task.game, self.agent, self.tables, discount)
        own = self._score("", plan.policies[self.agent]).mean_return
        return ObjectiveGap(missing_return=self.best.mean_over_starts - float(own or 0.0))

    def baselines(self) -> list[Score]:
        """Uniform play, the equilibrium of a zero-sum game of two, and the best response."""
        names = [UNIFORM, *([EQUILIBRIUM] if self.task.game.zero_sum else [])]
        scores = [self.score(name, named_agent(name, self.task, self.agent)) for name in names]
        return [*scores, self.optimum()]

    def optimum(self) -> Score:
        """As `Contest`."""
        rest = (self.task.game, self.agent, self.tables, self.task.max_steps)
        mean, steps, ended = play_of_response(*rest)
        return Score(BEST_RETURN, steps, 0.0, ended, self.episodes, True, mean_return=mean)

    def is_exact_for(self, policy: StatePolicy) -> bool:
        """As `Contest`: of tables."""
        return hasattr(policy, "table")

    @property
    def actions(self) -> FunctionActions:
        """As `Contest`: the numbers of actions."""
        return FunctionActions(self.task.num_actions(self.agent))

    def add_episodes(
        self,
        builder: Builder,
        policy: StatePolicy,
        games: Mapping[str, int],
        policy_name: str,
        encoding: str | None = None,
    ) -> None:
        """As `Contest`, with exact values and best responses."""
        policies = {**self.opponents, self.agent: policy}
        add_small_game(builder, self.task, policies, games, 1.0, self.players(policy_name))

    def scene(self, games: GameSimulator, caption: str, before: object = None) -> Drawable:
        """As `Contest`: the state as text."""
        return replace(scene_of(games), caption=caption)
