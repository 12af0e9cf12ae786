"""Rollouts of learners that remember: what was remembered goes with the games, step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import torch
from tensordict import TensorDict

from pursuit.masks import ACTION_MASK
from train.algorithms.learner import Games

Act = Callable[
    [dict[str, torch.Tensor], torch.Tensor], tuple[dict[str, torch.Tensor], torch.Tensor]
]
"""(what is seen, states) -> ("action" and whatever is kept for learning, states after)."""


class Sequences:
    """Plays on from where the last rollout ended, for ever; a collector for learners that remember.

    Args:
        env: the games.
        act: chooses the actions.
        size: numbers of a state.
        steps: of every game in a rollout.
        device: where the network lives, and where rollouts are kept.
        value: (observation, state) -> [games, 1], the value of what an episode that is cut off, or
            a rollout, ends with; None where nobody asks.
        keep_next: keep the next observations.

    Attributes:
        state: [batch, size] float32, what is remembered of every game now.
        fresh: [batch] bool, where an episode begins now: what is remembered there counts no more.
        states: [batch, size] each, before every step of the last rollout.
    """

    def __init__(
        self,
        env: Games,
        act: Act,
        size: int,
        steps: int,
        device: str,
        value: Callable[[torch.Tensor, torch.Tensor], torch.Tensor] | None = None,
        keep_next: bool = False,
    ) -> None:
        self.env, self.act, self.value = env, act, value
        self.steps, self.device, self.keep_next = steps, device, keep_next
        games = env.action_spec.shape[0]
        self.state = torch.zeros(games, size, device=device)
        self.fresh = torch.ones(games, dtype=torch.bool, device=device)
        self.states: list[torch.Tensor] = []
        self._now: Any = None

    def __iter__(self) -> Iterator[TensorDict]:
        """Rollouts for ever."""
        while True:
            yield self.rollout()

    @torch.no_grad()
    def rollout(self) -> TensorDict:
        """The next one, [batch, steps].

        Returns:
            What was seen, what `act` gave, "fresh" [batch, steps], of "next" the reward and the
            flags; "value_after" [batch, steps, 1], which stands where an episode was cut off and
            in the last step, and is 0 elsewhere; with `keep_next` "next_observation" and, where
            there are masks, "next_action_mask".
        """
        if self._now is None:
            self._now = self.env.reset()
        self.states = []
        rows = [self._step(last=step == self.steps - 1) for step in range(self.steps)]
        columns: dict[Any, torch.Tensor] = {
            name: torch.stack([row[name] for row in rows], dim=1) for name in rows[0]
        }
        return TensorDict(columns, batch_size=[len(self.state), self.steps])

    def _step(self, last: bool) -> dict[Any, torch.Tensor]:
        now = self._now
        names = [name for name in ("observation", ACTION_MASK, "idle") if now.get(name) is not None]
        row: dict[Any, torch.Tensor] = {name: now.get(name).to(self.device) for name in names}
        row["fresh"] = self.fresh
        self.states.append(self.state)
        chosen, self.state = self.act(row, self.state.masked_fill(self.fresh[:, None], 0.0))
        stepped, self._now = self.env.step_and_maybe_reset(
            now.set("action", chosen["action"].cpu())
        )
        after = stepped["next"]
        for name in ("reward", "terminated", "truncated", "done"):
            row["next", name] = after[name].to(self.device)
        if self.keep_next:
            for name in ("observation", ACTION_MASK):
                if after.get(name) is not None:
                    row[f"next_{name}"] = after[name].to(self.device)
        row |= chosen
        self.fresh = row["next", "done"].squeeze(-1)
        if self.value is not None:
            ended = row["next", "terminated"]
            apart = ~ended if last else row["next", "truncated"] & ~ended
            games = apart.squeeze(-1).nonzero().squeeze(-1)
            row["value_after"] = torch.zeros(apart.shape, device=self.device)
            if len(games):
                observation = after["observation"][games.cpu()].to(self.device)
                row["value_after"][games] = self.value(observation, self.state[games])
        return row

    def state_dict(self) -> dict[str, torch.Tensor]:
        """What is remembered now."""
        return {"state": self.state.cpu(), "fresh": self.fresh.cpu()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Take it back, before the first rollout."""
        self.state = state["state"].to(self.device)
        self.fresh = state["fresh"].to(self.device)

    def shutdown(self) -> None:
        """Nothing is held open."""
