"""The rollout loop of all learners, for any environment and network.

A feed-forward policy is a recurrent one with an empty state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.learner import VecEnv, expert_in, steps_tensors
from train.networks.policy import CRITIC

if TYPE_CHECKING:  # slow to import
    from tensordict import TensorDictBase

Columns = dict[str, torch.Tensor]
Seen: TypeAlias = "Columns | TensorDictBase"
"""Observations and, after a step, its results, by name."""
Act = Callable[[Columns, torch.Tensor], tuple[Columns, torch.Tensor]]
"""(observations, states) -> ("action" and other columns to keep, next states)."""

SEEN = ("observation", ACTION_MASK, "idle", CRITIC)
AFTER = ("reward", "terminated", "truncated", "done")
EXPERT = "expert"
"""Column of the probabilities [frames, actions] of the imitated policy."""
NEXT_MASK, NEXT_CRITIC = f"next_{ACTION_MASK}", f"next_{CRITIC}"


class Collector:
    """Collects rollouts, each from where the last one ended.

    Args:
        env: the environment.
        act: chooses the actions.
        steps: of every game in a rollout.
        state_size: size of the recurrent state.
        device: of the network and the rollouts.
        value: (observations, states) -> [n], the values of the final observations of truncated
            episodes and of the rollout; None if not needed.
        keep_next: keep the next observations.
        ended: called after every step with the mask of ended episodes, [games] bool.

    Attributes:
        state: [games, state_size] float32, the current recurrent states.
        episode_start: [games] bool, whether an episode starts now, so that its state is 0.
        states: [games, state_size] each, before every step of the last rollout.
    """

    def __init__(
        self,
        env: VecEnv,
        act: Act,
        steps: int,
        state_size: int = 0,
        device: str = "cpu",
        value: Callable[[Columns, torch.Tensor], torch.Tensor] | None = None,
        keep_next: bool = False,
        ended: Callable[[torch.Tensor], object] | None = None,
    ) -> None:
        self.env, self.act, self.steps, self.device = env, act, steps, device
        self.value, self.keep_next, self.ended = value, keep_next, ended
        games = env.rows
        self.state = torch.zeros(games, state_size, device=device)
        self.episode_start = torch.ones(games, dtype=torch.bool, device=device)
        self.states: list[torch.Tensor] = []
        self._now: Seen | None = None

    @torch.no_grad()
    def rollout(self) -> Columns:
        """The next rollout, columns [games, steps, ...].

        Returns:
            The observations, the results of `act`, "episode_start", "reward" and the flags after
            the step. With `value` also "value_after", the value of a final observation that no next
            step contains (0 elsewhere); with `keep_next` also "next_observation", which is the last
            one of an episode that ended, and with masks "next_action_mask".
        """
        if self._now is None:
            self._now = self.env.reset()
        self.states = []
        rows: list[Columns] = []
        cuts: list[Columns] = []  # of the games whose value after a step is needed
        for step in range(self.steps):
            row, after = self._step(self._now)
            rows.append(row)
            if self.value is not None:
                cut = ~row["terminated"]
                if step < self.steps - 1:
                    cut = cut & row["truncated"]
                games = cut.nonzero().squeeze(-1)
                if len(games):
                    names = [name for name in ("observation", CRITIC) if name in row]
                    seen = {name: after[name][games.cpu()].to(self.device) for name in names}
                    place = {"game": games, "step": torch.full_like(games, step)}
                    cuts.append({**seen, **place, "state": self.state[games]})
        columns = {name: torch.stack([row[name] for row in rows], dim=1) for name in rows[0]}
        if self.value is not None:
            after_cuts = columns["value_after"] = torch.zeros_like(columns["reward"])
            if cuts:
                seen = {name: torch.cat([each[name] for each in cuts]) for name in cuts[0]}
                after_cuts[seen["game"], seen["step"]] = self.value(seen, seen["state"])
        return columns

    def _step(self, now: Seen) -> tuple[Columns, Seen]:
        """The kept columns of a step, and all its results."""
        row = {name: now[name].to(self.device) for name in SEEN if name in now.keys()}  # noqa: SIM118 (of a TensorDict)
        row["episode_start"] = self.episode_start
        if expert_in(self.env) is not None:
            row[EXPERT] = cast(Any, self.env).expert_probabilities().to(self.device)
        self.states.append(self.state)
        state = self.state.masked_fill(self.episode_start[:, None], 0.0)
        chosen, self.state = self.act(row, state)
        after, self._now = step_games(self.env, now, chosen["action"].cpu())
        row |= chosen
        row |= {name: after[name].squeeze(-1).to(self.device) for name in AFTER}
        self.episode_start = row["done"]
        if self.keep_next:
            names = [name for name in ("observation", CRITIC, ACTION_MASK) if name in row]
            row |= {f"next_{name}": after[name].to(self.device) for name in names}
        if self.ended is not None:
            self.ended(row["done"])
        return row, after

    def state_dict(self) -> Columns:
        """The recurrent states, and the starts of episodes."""
        return {"state": self.state.cpu(), "fresh": self.episode_start.cpu()}

    def load_state_dict(self, state: Columns) -> None:
        """Restore the state, before the first rollout."""
        self.state = state["state"].to(self.device)
        self.episode_start = state["fresh"].to(self.device)


def step_games(env: VecEnv, now: Seen, action: torch.Tensor) -> tuple[Seen, Seen]:
    """The results of a step, and the observations for the next step: where an episode ended, the
    first one of the next episode.

    Args:
        env: the environment; a `BatchEnv` is stepped without TensorDicts.
        now: the observations before the step.
        action: [games, ...].
    """
    if steps_tensors(env):
        return cast(Any, env).step_tensors(action)
    now = cast("TensorDictBase", now).set("action", action)
    stepped, following = cast(Any, env).step_and_maybe_reset(now)
    return stepped["next"], following
