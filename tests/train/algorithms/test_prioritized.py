"""Replay: the ring of rows, what is drawn from it, and prioritised draws."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from train.algorithms.prioritized import Priorities
from train.algorithms.replay import ReplayBuffer


def rows_of(numbers: list[int]) -> dict[str, torch.Tensor]:
    """Rows that say which they are, in columns of every width and shape that learners have."""
    number = torch.tensor(numbers)
    return {
        "observation": number[:, None, None].expand(-1, 3, 2).to(torch.int16),
        "action": number,
        "reward": number / 8,
        "terminated": number % 2 == 0,
        "nothing": torch.zeros(len(numbers), 0, 4),
        "planes": (number[:, None] + torch.arange(5)).to(torch.uint8),
    }


def check_rows(found: dict[str, torch.Tensor], numbers: list[int]) -> None:
    for name, column in rows_of(numbers).items():
        assert found[name].dtype == column.dtype and torch.equal(found[name], column), name


# -- the ring --------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(capacity=st.integers(1, 12), sizes=st.lists(st.integers(1, 30), min_size=1, max_size=6))
def test_the_ring_is_a_list_whose_oldest_rows_are_overwritten(
    capacity: int, sizes: list[int]
) -> None:
    replay = ReplayBuffer(capacity, torch.Generator())
    expected: dict[int, int] = {}
    written = 0
    for size in sizes:
        replay.extend(rows_of(list(range(written, written + size))))
        expected |= {number % capacity: number for number in range(written, written + size)}
        written += size
    assert len(replay) == min(written, capacity) and replay.cursor == written % capacity
    check_rows(replay.columns(), [expected[place] for place in sorted(expected)])
    drawn = replay.draw(50)
    check_rows(drawn, drawn["action"].tolist())
    assert set(drawn["action"].tolist()) <= set(expected.values())


def test_uniform_draws_are_those_of_torchrls_sampler() -> None:
    from tensordict import TensorDict
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

    ours = ReplayBuffer(40, torch.Generator().manual_seed(3))
    theirs: Any = TensorDictReplayBuffer(
        storage=LazyTensorStorage(40), batch_size=16, generator=torch.Generator().manual_seed(3)
    )
    for first in (0, 25, 50):
        numbers = list(range(first, first + 25))
        ours.extend(rows_of(numbers))
        theirs.extend(TensorDict({"action": torch.tensor(numbers)}, batch_size=[25]))
        for _ in range(3):
            assert torch.equal(ours.draw(16)["action"], theirs.sample()["action"])


@pytest.mark.parametrize("prioritized", [False, True])
def test_a_ring_that_is_saved_goes_on_as_if_it_had_not_been(prioritized: bool) -> None:
    def ring() -> ReplayBuffer:
        counts = Priorities(10, 0.6) if prioritized else None
        return ReplayBuffer(10, torch.Generator().manual_seed(1), counts)

    one, other = ring(), ring()
    one.extend(rows_of(list(range(13))))
    if prioritized:
        one.update(torch.tensor([1, 4, 9]), torch.tensor([0.5, 3.0, 0.1]))
    one.draw(5, 0.4)
    other.load_state_dict(one.state_dict())
    for replay in (one, other):
        replay.extend(rows_of([13, 14]))
    first, second = one.draw(20, 0.4), other.draw(20, 0.4)
    assert set(first) == set(second)
    for name, column in first.items():
        assert torch.equal(column, second[name]), name


# -- priorities ------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(data=st.data(), capacity=st.integers(1, 40))
def test_trees_equal_plain_lists(data: st.DataObject, capacity: int) -> None:
    tree = Priorities(capacity, 1.0)
    priorities = [0.0] * capacity
    for _ in range(data.draw(st.integers(1, 4))):
        indices = data.draw(st.lists(st.integers(0, capacity - 1), min_size=1))
        values = [data.draw(st.integers(1, 64)) / 8 for _ in indices]
        for index, value in zip(indices, values, strict=True):
            priorities[index] = value
        tree._set(torch.tensor(indices), torch.tensor(values))
    assert tree.read(capacity).tolist() == priorities
    assert float(tree.sums[1]) == sum(priorities)
    assert float(tree.minima[1]) == min(value for value in priorities if value)
    generator = torch.Generator().manual_seed(capacity)
    masses = torch.rand(20, generator=generator) * sum(priorities)
    index, weights = tree.draw(20, capacity, 0.5, generator.manual_seed(capacity))
    smallest = min(value for value in priorities if value)
    for mass, found, weight in zip(masses.tolist(), index.tolist(), weights.tolist(), strict=True):
        expected = next(i for i in range(capacity) if sum(priorities[: i + 1]) > mass)
        assert found == expected
        assert weight == pytest.approx((priorities[found] / smallest) ** -0.5, rel=1e-5)


def test_prioritised_draws_follow_the_priorities_and_weights_undo_them() -> None:
    replay = ReplayBuffer(6, torch.Generator().manual_seed(0), Priorities(6, 0.5))
    replay.extend(rows_of(list(range(5))))
    errors = torch.tensor([1.0, 4.0, 9.0, 16.0, 0.0])
    replay.update(torch.arange(5), errors)
    batch = replay.draw(60_000, 1.0)
    drawn = batch["action"]
    assert torch.equal(drawn, batch["index"])
    share = torch.bincount(drawn, minlength=5) / 60_000
    expected = (errors + 1e-8).sqrt() / (errors + 1e-8).sqrt().sum()
    torch.testing.assert_close(share, expected, atol=0.01, rtol=0)
    # (p_i / min p) ** -1 makes the weighted draws uniform over what has been drawn.
    weights = torch.stack([batch["priority_weight"][drawn == row][0] for row in range(4)])
    even = weights * share[:4] / (weights * share[:4]).sum()
    torch.testing.assert_close(even, torch.full((4,), 0.25), atol=0.02, rtol=0)


def test_new_rows_count_as_the_largest_error_that_was_seen() -> None:
    replay = ReplayBuffer(4, torch.Generator().manual_seed(0), Priorities(4, 1.0))
    assert replay.priorities is not None
    replay.extend(rows_of([0, 1, 2]))
    assert replay.priorities.read(3).tolist() == pytest.approx([1.0, 1.0, 1.0])
    replay.update(torch.tensor([0, 2]), torch.tensor([0.5, 3.0]))
    replay.extend(rows_of([3, 4]))  # one of them over the oldest
    assert replay.priorities.read(4).tolist() == pytest.approx([3.0, 1.0, 3.0, 3.0])
