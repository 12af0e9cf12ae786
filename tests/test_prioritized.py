"""Prioritised replay: segment trees, and what is drawn."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from train.algorithms.prioritized import (
    SegmentTree,
    TorchPrioritizedSampler,
    extension_loads,
    prioritized_sampler,
)

# -- prioritised replay ----------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(data=st.data(), capacity=st.integers(1, 40))
def test_segment_trees_equal_plain_lists(data: st.DataObject, capacity: int) -> None:
    priorities = [0.0] * capacity
    sums, minima = SegmentTree(capacity), SegmentTree(capacity, minimum=True)
    for _ in range(data.draw(st.integers(1, 4))):
        indices = data.draw(st.lists(st.integers(0, capacity - 1), min_size=1, unique=True))
        values = [data.draw(st.integers(1, 64)) / 8 for _ in indices]
        for index, value in zip(indices, values, strict=True):
            priorities[index] = value
        for tree in (sums, minima):
            tree[torch.tensor(indices)] = torch.tensor(values)
    low = data.draw(st.integers(0, capacity - 1))
    high = data.draw(st.integers(low + 1, capacity))
    assert sums.query(low, high) == sum(priorities[low:high])
    written = [value for value in priorities[low:high] if value]
    assert minima.query(low, high) == min(written, default=float("inf"))
    mass = data.draw(st.floats(0, sum(priorities), exclude_max=True))
    expected = next(i for i in range(capacity) if sum(priorities[: i + 1]) > mass)
    assert int(sums.scan_lower_bound(torch.tensor([mass], dtype=torch.float64))) == expected


def test_prioritised_draws_follow_the_priorities_and_weights_undo_them() -> None:
    sampler = TorchPrioritizedSampler(max_capacity=6, alpha=0.5, beta=1.0)
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

    replay = TensorDictReplayBuffer(
        storage=LazyTensorStorage(6), sampler=sampler, batch_size=60_000, priority_key="td_error"
    )
    replay.extend(TensorDict({"x": torch.arange(5)}, batch_size=[5]))
    priority = torch.tensor([1.0, 4.0, 9.0, 16.0, 0.0])
    replay.update_priority(torch.arange(5), priority)
    batch = replay.sample()
    share = torch.bincount(batch["x"], minlength=5) / 60_000
    expected = (priority + 1e-8).sqrt() / (priority + 1e-8).sqrt().sum()
    torch.testing.assert_close(share, expected, atol=0.01, rtol=0)
    # (p_i / min p) ** -1 makes the weighted draws uniform over what has been drawn.
    weights = torch.stack([batch["priority_weight"][batch["x"] == x][0] for x in range(4)])
    torch.testing.assert_close(
        weights * share[:4] / (weights * share[:4]).sum(), torch.full((4,), 0.25), atol=0.02, rtol=0
    )


def test_the_compiled_sampler_is_used_where_it_loads() -> None:
    sampler = prioritized_sampler(8, 0.6, 0.4)
    assert isinstance(sampler, TorchPrioritizedSampler) != extension_loads()
