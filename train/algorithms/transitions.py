"""Rollouts for learners that replay: what was seen, what was done, and what stood after it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import torch

from pursuit.masks import ACTION_MASK
from train.algorithms.learner import Games
from train.environments.lockstep import LockstepEnv

NEXT_MASK = "next_action_mask"

Rollout = dict[str, torch.Tensor]
"""Of every game and step, [games, steps, ...]: "observation", "action", "reward", "terminated",
"done", "next_observation" (the last one of an episode that ended, not the first of the next) and,
where there are masks, "next_action_mask"."""


class Transitions:
    """Plays on from where the last rollout ended, for ever.

    What TorchRL's collector does, without its fixed cost: a loop over the tensors of the games.

    Args:
        env: the games.
        act: [games, ...] actions from what is seen, "observation" and masks.
        steps: of every game in a rollout.
        ended: told after every step whose episode is over, [games] bool.
    """

    def __init__(
        self,
        env: Games,
        act: Callable[[Mapping[str, torch.Tensor]], torch.Tensor],
        steps: int,
        ended: Callable[[torch.Tensor], object] | None = None,
    ) -> None:
        self.env, self.act, self.steps, self.ended = env, act, steps, ended
        self._now: Any = None

    def __iter__(self) -> Iterator[Rollout]:
        """Rollouts for ever."""
        while True:
            yield self.rollout()

    @torch.no_grad()
    def rollout(self) -> Rollout:
        """The next one, on the CPU."""
        if self._now is None:
            self._now = self.env.reset()
        rows = [self._step() for _ in range(self.steps)]
        if self.steps == 1:
            return {name: column.unsqueeze(1) for name, column in rows[0].items()}
        return {name: torch.stack([row[name] for row in rows], dim=1) for name in rows[0]}

    def _step(self) -> Rollout:
        now = self._now
        action = self.act(now).cpu()
        after, self._now = self._stepped(action)
        row = {"observation": now["observation"], "action": action}
        row |= {name: after[name].squeeze(-1) for name in ("reward", "terminated", "done")}
        row["next_observation"] = after["observation"]
        mask = after.get(ACTION_MASK, None)
        if mask is not None:
            row[NEXT_MASK] = mask
        if self.ended is not None:
            self.ended(row["done"])
        return row

    def _stepped(self, action: torch.Tensor) -> tuple[Any, Any]:
        """What stands after a step, and what is seen then by whoever plays on."""
        if isinstance(self.env, LockstepEnv):
            return self.env.step_tensors(action)
        stepped, following = self.env.step_and_maybe_reset(self._now.set("action", action))
        return stepped["next"], following

    def shutdown(self) -> None:
        """Nothing is held open."""


def n_step_rows(rollout: Rollout, gamma: float, n_steps: int) -> Rollout:
    """Transitions [games * steps] of up to `n_steps` rewards each, as a replay buffer holds them.

    A return ends with its episode, or with the rollout, where that is sooner.

    Args:
        rollout: of every game and step.
        gamma: discount of a step.
        n_steps: rewards in one.

    Returns:
        "observation" and "action" of the step; "reward", the discounted sum; "next_observation",
        "terminated" and masks of the last step that was counted; "steps" int64, how many were.
    """
    reward, done = rollout["reward"], rollout["done"]
    games, steps = reward.shape
    total, going = reward.clone(), torch.ones_like(done)
    ahead = torch.zeros(games, steps, dtype=torch.int64, device=reward.device)
    for further in range(1, min(n_steps, steps)):
        there = steps - further
        going = going[:, :there] & ~done[:, further - 1 : steps - 1]
        total[:, :there] += gamma**further * reward[:, further:] * going
        ahead[:, :there] += going
    rows = {
        "observation": rollout["observation"].flatten(0, 1),
        "action": rollout["action"].flatten(0, 1),
        "reward": total.flatten(),
        "steps": ahead.flatten() + 1,
    }
    last = torch.arange(games * steps, device=reward.device) + ahead.flatten()
    for name in ("next_observation", "terminated", NEXT_MASK):
        if name in rollout:
            column = rollout[name].flatten(0, 1)
            rows[name] = column if n_steps == 1 else column.index_select(0, last)
    return rows
