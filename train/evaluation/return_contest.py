"""Evaluation in returns, of an agent of any game with a `Batch`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.rendering.rendering import Drawable
from pursuit.rendering.text import text_scene
from pursuit.replays.viewer.data import Builder
from pursuit.simulator.batch import Batch
from pursuit.validation import Missing, need
from scripted_agents.agents.random_policy import RandomPolicy
from scripted_agents.exact.references import ReturnSolver, Solution
from train.evaluation.games import half_width, play_out, stepper
from train.evaluation.scores import (
    BEST_RETURN,
    BY_RETURN,
    Contest,
    FunctionActions,
    Measure,
    Score,
    label_of,
)
from train.evaluation.text_replay import add_text_episodes
from train.files import Plain
from train.settings.checks import EVALUATION_SEED

NO_SOLVER = Missing("this game has no solver")
NO_RANDOM = Missing("this game has only learned policies; give the folder of a run")


@dataclass(frozen=True)
class ReturnContest(Contest[Any, Any]):
    """Evaluation of an agent, or of all agents of a role, against fixed policies, by episodes.

    The measure is the return of an episode, without discount; of several agents their sum. The
    success rate of a score is the share of episodes that end in time.

    Attributes:
        task: the game.
        agent: name or role.
        opponents: the policies of the other agents, by name.
        batch: the class of the simulator.
        episodes, seed: as of `Contest`.
        solver: of best responses; or why there is none.
        random: the random policy of the agent; or why there is none.
    """

    measure: ClassVar[Measure] = BY_RETURN
    success: ClassVar[str] = "ended"

    task: Any
    agent: str
    opponents: Mapping[str, Any]
    batch: type[Batch[Any]]
    episodes: int = 1000
    seed: int = EVALUATION_SEED
    solver: ReturnSolver | Missing = NO_SOLVER
    random: RandomPolicy | Missing = NO_RANDOM

    @property
    def simulator(self) -> type[Batch[Any]]:
        """As `Contest`."""
        return self.batch

    @property
    def names(self) -> tuple[str, ...]:
        """The agents that the evaluated policy plays."""
        task = self.task
        if self.agent in task.agent_names:
            return (self.agent,)
        roles = zip(task.agent_names, task.seat_roles, strict=True)
        return tuple(name for name, role in roles if role == self.agent)

    @cached_property
    def exact_reference(self) -> Solution:
        """As `Contest`: that of the solver."""
        if isinstance(self.solver, Missing):
            return Solution("none", self.solver.reason)
        why = self.solver.why_not(self.task, self.opponents)
        return Solution("response") if why is None else Solution("none", why)

    @cached_property
    def response(self) -> tuple[float, Any] | None:
        """The best expected return and its policy; None if it is not known."""
        if self.exact_reference.reason:
            return None
        solver: ReturnSolver = need(self.solver)
        return solver.respond(self.task, self.agent, self.opponents)

    def describe(self) -> Plain:
        """As `Contest`."""
        game = self.task.name
        return {"task": game, "role": self.agent, "maze": None, "game": game}

    def line(self) -> str:
        """As `Contest`."""
        others = ", ".join(f"{name} {label_of(own)}" for name, own in self.opponents.items())
        return (
            f"{self.task.name}: {self.agent}, {'with ' + others if others else 'alone'}, at most "
            f"{self.task.max_steps} steps"
        )

    def players(self, policy_name: str) -> dict[str, str]:
        """As `Contest`."""
        others = {name: label_of(own) for name, own in self.opponents.items()}
        return others | dict.fromkeys(self.names, policy_name)

    # -- scores --------------------------------------------------------------------------------

    def score(self, name: str, policy: Any) -> Score:
        """As `Contest`, of sampled episodes; the return is exact where the solver gives it."""
        score, task = self._sampled(name, policy), self.task
        if isinstance(self.solver, Missing):
            return score
        policies = {**self.opponents, **dict.fromkeys(self.names, policy)}
        if self.solver.why_not(task, policies) is not None:
            return score
        returns = self.solver.returns(task, policies)
        value = float(sum(returns[task.seat(each)] for each in self.names))
        return self._exact(score, value)

    def _exact(self, score: Score, value: float) -> Score:
        exact: Any = {"exact": True, "mean_return": value, "value_ci95": 0.0}
        return replace(score, **exact, apart="steps and ends: sampled")

    def _sampled(self, name: str, policy: Any) -> Score:
        lengths, ended, returns = self.played_out(policy)
        value, half = float(returns.mean()), half_width(returns)
        return Score.of_episodes(name, lengths, ended, mean_return=value, value_ci95=half)

    def played_out(
        self, policy: Any
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
        """As `play`, and the returns of the agent [episodes]."""
        games: Any = self.starts()
        step = self.stepper(games, policy)
        lengths, ended = play_out(
            games, step, lambda each: each.ended, lambda each: each.terminated
        )
        found = games.returns
        if found.ndim > 1:  # else all agents share them
            found = found[:, [self.task.seat(name) for name in self.names]].sum(axis=1)
        return lengths, ended, np.array(found, dtype=np.float64)

    def values(self, policy: Any) -> NDArray[np.float64]:
        """As `Contest`."""
        return self.played_out(policy)[2]

    def optimum(self) -> Score | None:
        """As `Contest`: exact in its return."""
        if self.response is None:
            return None
        value, policy = self.response
        return self._exact(self._sampled(BEST_RETURN, policy), value)

    @property
    def actions(self) -> FunctionActions:
        """As `Contest`: those of the random policy."""
        return FunctionActions(need(self.random).num_actions)

    def baselines(self) -> list[Score]:
        """The random policy, and the best response where it is known: exact in its return."""
        missing = isinstance(self.random, Missing)
        scores = [] if missing else [self.score("random", self.random)]
        best = self.optimum()
        return scores if best is None else [*scores, best]

    def scripted(self) -> Any:
        """As `Contest`: the random policy."""
        return need(self.random)

    def best_policy(self) -> Any:
        """As `Contest`."""
        return super().best_policy() if self.response is None else self.response[1]

    # -- episodes ------------------------------------------------------------------------------

    def stepper(self, games: Any, policy: Any) -> Callable[[], None]:
        """As `Contest`."""
        by_name = {**self.opponents, **dict.fromkeys(self.names, policy)}
        return stepper(games, [by_name[name] for name in self.task.agent_names])

    def scene(self, games: Any, caption: str, before: object = None) -> Drawable:
        """As `Contest`: the state as text."""
        return replace(text_scene(games, 0, games.text(0)), caption=caption)

    def add_episodes(
        self,
        builder: Builder,
        policy: Any,
        games: Mapping[str, int],
        policy_name: str,
        encoding: str | None = None,
    ) -> None:
        """As `Contest`, as text; there are no replays."""
        by_name = {**self.opponents, **dict.fromkeys(self.names, policy)}
        agents, labels = self.task.agent_names, self.players(policy_name)
        policies = [by_name[name] for name in agents]
        add_text_episodes(builder, self.start, policies, games, [labels[name] for name in agents])
