"""Rollouts of games on a GPU that may be captured: all their steps are one CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import nn

from train.algorithms.graphs import Graphs, Repeated
from train.algorithms.learner import prepared
from train.algorithms.transitions import Rollout

Columns = dict[str, torch.Tensor]
Act = Callable[[torch.Tensor], Columns]
"""From observations [games, ...] the "action" and whatever is kept beside it, [games, ...]."""


class DeviceSteps:
    """Plays on from where the last rollout ended, for ever.

    Args:
        env: the games, a `DeviceEnv`.
        act: chooses the actions.
        network: that it chooses by.
        steps: of every game in a rollout.
        graphs: who captures.

    Attributes:
        repeated: the steps of a rollout.
    """

    def __init__(self, env: Any, act: Act, network: nn.Module, steps: int, graphs: Graphs) -> None:
        self.env, self.act, self.network, self.steps = env, act, network, steps
        self.repeated = Repeated("collecting", self._play, self._changed, self._depends, graphs)
        self._now: torch.Tensor | None = None

    def begin(self) -> Any:
        """Have the first episodes begin; what is seen, as the games give it."""
        begun = self.env.reset()
        self._now = begun["observation"]
        return begun

    def play(self) -> tuple[Columns, Columns]:
        """What was seen and done in every step, and what stood after it, [games, steps, ...]; the
        next rollout overwrites it."""
        if self._now is None:
            self.begin()
        reason = self.env.why_not_captured()
        if reason is not None and self.repeated.refused is None:
            self.repeated.refuse(reason)
        found = self.repeated()
        self.env.notes = [*self.env.notes, *found["notes"]]
        return found["seen"], found["after"]

    @torch.no_grad()
    def _play(self) -> dict[str, Any]:
        """All steps of a rollout: what was seen and done, what stood after it, what was noted."""
        assert self._now is not None
        noted, now = self.env.notes, self._now
        seen: list[Columns] = []
        afterwards: list[Columns] = []
        self.env.notes = []
        try:
            for _ in range(self.steps):
                seen.append({"observation": now, **self.act(now)})
                after, following = self.env.step_tensors(seen[-1]["action"])
                afterwards.append(after)
                now = following["observation"]
            found = {"seen": stacked(seen), "after": stacked(afterwards), "notes": self.env.notes}
        finally:
            self.env.notes = noted
        self._now.copy_(now)
        return found

    def _changed(self) -> list[torch.Tensor]:
        assert self._now is not None
        return [*self.env.changed(), self._now]

    def _depends(self) -> Hashable:
        weights = [weight.data_ptr() for weight in self.network.parameters()]
        return tuple(weights), self.env.depends()

    def shutdown(self) -> None:
        """Nothing is held open."""


class DeviceRollouts(DeviceSteps):
    """What TorchRL's collector does.

    Args:
        env, steps, graphs: as `DeviceSteps`.
        policy: acts, and says what is kept beside its actions (`out_keys`).
    """

    def __init__(self, env: Any, policy: TensorDictModuleBase, steps: int, graphs: Graphs) -> None:
        super().__init__(env, self._asked, policy, steps, graphs)
        self.policy = policy
        # As the collector does: so all that is drawn is the same with graphs and without.
        with torch.no_grad():
            policy(self.begin())

    def _asked(self, observation: torch.Tensor) -> Columns:
        chosen = TensorDict({"observation": observation}, [self.env.num_games], self.env.device)
        self.policy(chosen)
        return {name: chosen[name] for name in self.policy.out_keys}

    def __iter__(self) -> Iterator[TensorDict]:
        """Rollouts [games, steps] for ever, with the keys of TorchRL's collector."""
        how: Any = {"batch_size": [self.env.num_games, self.steps], "device": self.env.device}
        while True:
            seen, after = self.play()
            yield TensorDict({**seen, "next": TensorDict(after, **how)}, **how)


class DeviceTransitions(DeviceSteps):
    """What `Transitions` does."""

    def __iter__(self) -> Iterator[Rollout]:
        """Rollouts for ever."""
        while True:
            with prepared(self.env, self.steps):
                seen, after = self.play()
            rollout = {name: seen[name] for name in ("observation", "action")}
            rollout |= {name: after[name].squeeze(-1) for name in ("reward", "terminated", "done")}
            yield rollout | {"next_observation": after["observation"]}


def stacked(rows: list[Columns]) -> Columns:
    """Columns [games, steps, ...] of rows of [games, ...]."""
    return {name: torch.stack([row[name] for row in rows], dim=1) for name in rows[0]}
