"""Rollouts of games on a GPU that may be captured: all their steps are one CUDA graph."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from train.algorithms.graphs import Graphs, Repeated


class DeviceRollouts:
    """Plays on from where the last rollout ended, for ever; what TorchRL's collector does.

    Args:
        env: the games, a `DeviceEnv`.
        policy: acts, and says what is kept beside its actions (`out_keys`).
        steps: of every game in a rollout.
        graphs: who captures.

    Attributes:
        repeated: the steps of a rollout.
    """

    def __init__(self, env: Any, policy: TensorDictModuleBase, steps: int, graphs: Graphs) -> None:
        self.env, self.policy, self.steps = env, policy, steps
        self.repeated = Repeated("collecting", self._play, self._changed, self._depends, graphs)
        # As the collector does: so all that is drawn is the same with graphs and without.
        begun = env.reset()
        self._now: torch.Tensor = begun["observation"]
        with torch.no_grad():
            policy(begun)

    def __iter__(self) -> Iterator[TensorDict]:
        """Rollouts [games, steps] for ever; the next one overwrites the last."""
        while True:
            yield self.rollout()

    def rollout(self) -> TensorDict:
        """The next one, [games, steps], with the keys of TorchRL's collector."""
        reason = self.env.why_not_captured()
        if reason is not None and self.repeated.refused is None:
            self.repeated.refuse(reason)
        found = self.repeated()
        self.env.notes = [*self.env.notes, *found["notes"]]
        how: Any = {"batch_size": [self.env.num_games, self.steps], "device": self.env.device}
        return TensorDict({**found["seen"], "next": TensorDict(found["after"], **how)}, **how)

    @torch.no_grad()
    def _play(self) -> dict[str, Any]:
        """All steps of a rollout: what was seen and done, what stood after it, what was noted."""
        noted, now = self.env.notes, self._now
        seen: list[dict[str, torch.Tensor]] = []
        afterwards: list[dict[str, torch.Tensor]] = []
        self.env.notes = []
        try:
            for _ in range(self.steps):
                chosen = TensorDict({"observation": now}, [self.env.num_games], self.env.device)
                self.policy(chosen)
                seen.append({name: chosen[name] for name in ("observation", *self.policy.out_keys)})
                after, following = self.env.step_tensors(chosen["action"])
                afterwards.append(after)
                now = following["observation"]
            found = {"seen": stacked(seen), "after": stacked(afterwards), "notes": self.env.notes}
        finally:
            self.env.notes = noted
        self._now.copy_(now)
        return found

    def _changed(self) -> list[torch.Tensor]:
        return [*self.env.changed(), self._now]

    def _depends(self) -> Hashable:
        weights = [weight.data_ptr() for weight in self.policy.parameters()]
        return tuple(weights), self.env.depends()

    def shutdown(self) -> None:
        """Nothing is held open."""


def stacked(rows: list[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """Columns [games, steps, ...] of rows of [games, ...]."""
    return {name: torch.stack([row[name] for row in rows], dim=1) for name in rows[0]}
