"""The replay buffer: a ring of rows in one block of memory."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from train.algorithms.collector import NEXT_CRITIC, NEXT_MASK, Columns
from train.algorithms.prioritized import Priorities
from train.networks.policy import CRITIC
from train.tensors import StateDict

ALIGNED = 8
"""Alignment of rows, in bytes."""
NEXT_IDLE = "next_idle"
OF_STEP = ("observation", "action", "idle", CRITIC)

Minibatch = Mapping[str, torch.Tensor]
"""Drawn rows, [batch, ...] by column name."""


def weighted_mean(values: torch.Tensor, batch: Minibatch) -> torch.Tensor:
    """The mean of [batch] values; with prioritised replay weighted, as in TorchRL."""
    weight = batch.get("priority_weight", None)
    return values.mean() if weight is None else (weight * values).sum() / weight.sum()


@torch.no_grad()
def returns_to_expect(batch: Minibatch, values: torch.Tensor, gamma: float) -> torch.Tensor:
    """[batch]: rewards plus the discounted values [batch] of non-terminal next observations."""
    return batch["reward"] + gamma ** batch["steps"] * ~batch["terminated"] * values


class ReplayBuffer:
    """A ring buffer of rows.

    The columns of a row are contiguous, so that drawing a row reads one block of memory.

    Args:
        capacity: rows.
        generator: of the draws, on the CPU.
        priorities: of the rows; None for uniform sampling.

    Attributes:
        capacity, generator, priorities: the arguments.
        cursor: the next row to be written.
    """

    def __init__(
        self, capacity: int, generator: torch.Generator, priorities: Priorities | None = None
    ) -> None:
        self.capacity, self.generator, self.priorities = capacity, generator, priorities
        self.cursor = self._filled = 0
        self._memory = torch.empty(0, dtype=torch.uint8)
        self._places: dict[str, tuple[int, torch.dtype, torch.Size, tuple[int, ...]]] = {}

    def __len__(self) -> int:
        return self._filled

    def columns(self) -> Columns:
        """Every row, [rows, ...]; views of the memory."""
        return self._split(self._memory[: self._filled])

    def extend(self, rows: Minibatch) -> None:
        """Write rows [n, ...]; of more than `capacity` the last ones."""
        count = len(next(iter(rows.values())))
        if not self._places:
            self._lay_out(rows)
        whole = self._split(self._memory)
        skipped = max(count - self.capacity, 0)
        begin = (self.cursor + skipped) % self.capacity
        first = min(count - skipped, self.capacity - begin)
        for name, column in whole.items():
            new = rows[name]
            column[begin : begin + first] = new[skipped : skipped + first]
            if skipped + first < count:
                column[: count - skipped - first] = new[skipped + first :]
        written = begin + torch.arange(count - skipped)
        self.cursor = (self.cursor + count) % self.capacity
        self._filled = min(self._filled + count, self.capacity)
        if self.priorities is not None:
            self.priorities.begin(written % self.capacity)

    def draw(self, count: int, beta: float = 0.0) -> Columns:
        """`count` rows, [count, ...], on the CPU.

        Args:
            count: number of rows.
            beta: with priorities, the exponent of the weights.

        Returns:
            The columns; with priorities also "index" and "priority_weight".
        """
        more: Columns = {}
        if self.priorities is None:
            # The same draws as TorchRL's uniform sampler.
            index = torch.randint(0, self._filled, (count,), generator=self.generator)
        else:
            index, weight = self.priorities.draw(count, self._filled, beta, self.generator)
            more = {"index": index, "priority_weight": weight}
        return {**self._split(self._memory.index_select(0, index)), **more}

    def update(self, index: torch.Tensor, errors: torch.Tensor) -> None:
        """Set the priorities of rows [n] by their absolute errors [n]."""
        assert self.priorities is not None
        self.priorities.update(index, errors.cpu())

    def state_dict(self) -> StateDict:
        """Every row, the cursor, the generator and the priorities; on the CPU."""
        state: StateDict = {
            # Copies, as torch cannot save views of one memory with several types.
            "replay": {name: rows.clone() for name, rows in self.columns().items()},
            "cursor": self.cursor,
            "generator": self.generator.get_state(),
        }
        if self.priorities is not None:
            values, largest = self.priorities.read(self._filled), self.priorities.largest
            state["priorities"] = {  # two equal entries, for the format of checkpoints
                "sum": values,
                "min": values,
                "largest": None if largest is None else float(largest),
            }
        return state

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state of an empty buffer; the caller checks that it matches."""
        self.generator.set_state(state["generator"])
        if not len(state["replay"].get("action", ())):
            return
        self.extend(state["replay"])
        self.cursor = state["cursor"]
        if self.priorities is not None:
            saved = state["priorities"]
            self.priorities.write(saved["sum"])
            if saved["largest"] is not None:
                self.priorities.largest = torch.tensor(saved["largest"])

    def _lay_out(self, rows: Minibatch) -> None:
        """Choose the position of every column in a row: widest types first, for alignment."""
        end = 0
        for name, column in sorted(rows.items(), key=lambda item: -item[1].element_size()):
            shape = column.shape[1:]
            self._places[name] = (end, column.dtype, shape, torch.empty(shape).stride())
            end += column[0].numel() * column.element_size()
        size = -(-end // ALIGNED) * ALIGNED
        self._memory = torch.empty(self.capacity, size, dtype=torch.uint8)

    def _split(self, memory: torch.Tensor) -> Columns:
        """The columns [n, ...] of rows [n, bytes]; views."""
        columns: Columns = {}
        for name, (place, dtype, shape, strides) in self._places.items():
            whole, row = memory.view(dtype), memory.shape[1] // dtype.itemsize
            begin = whole.storage_offset() + place // dtype.itemsize
            columns[name] = whole.as_strided((len(memory), *shape), (row, *strides), begin)
        return columns


def n_step_rows(rollout: Columns, gamma: float, n_steps: int) -> Columns:
    """N-step transitions [games * steps], as rows of a replay buffer.

    A return ends with its episode or with the rollout.

    Args:
        rollout: of a `Collector` with `keep_next`.
        gamma: discount of a step.
        n_steps: largest number of rewards of a return.

    Returns:
        "observation" and "action" of the step; "reward", the discounted sum; "next_observation",
        "terminated" and masks of the last step of the return; "steps" int64, its length. Of teams
        also "idle" and "next_idle", the agents that have left, and the observations of a central
        critic.
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
    rows = {name: rollout[name].flatten(0, 1) for name in OF_STEP if name in rollout}
    rows |= {"reward": total.flatten(), "steps": ahead.flatten() + 1}
    last = torch.arange(games * steps, device=reward.device) + ahead.flatten()
    for name in ("next_observation", "terminated", NEXT_MASK, NEXT_IDLE, NEXT_CRITIC):
        if name in rollout:
            column = rollout[name].flatten(0, 1)
            rows[name] = column if n_steps == 1 else column.index_select(0, last)
    return rows
