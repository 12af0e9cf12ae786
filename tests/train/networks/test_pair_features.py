"""Weights for pairs of cells, beside those of single cells."""

from __future__ import annotations

import torch

from pursuit.observations.observations import Encoder
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from train.networks.layers import IndexLayer
from train.networks.policy import Seat


def test_pairs_are_rows_of_their_own_and_shared_by_all_goals() -> None:
    task = make_task("maze", maze="3x3", num_goals=2)
    features = Seat(task, "runner").features
    layer = IndexLayer(features, 4, "bag", pairs=True)
    assert layer.pairs is not None and layer.pairs.shape == (9 * 9 + 1, 4)
    plain = IndexLayer(features, 4, "bag")
    plain.load_state_dict({"weight": layer.weight, "bias": layer.bias})
    simulator = Simulator(task, 50, seed=4)
    seen = torch.from_numpy(Encoder(task, "index").encode(simulator.games))[:, 0]
    assert torch.equal(layer(layer.prepare(seen)), plain(plain.prepare(seen)))  # they begin at 0
    with torch.no_grad():
        layer.pairs.normal_()
        layer.pairs[-1] = 0.0
    found = layer(layer.prepare(seen)) - plain(plain.prepare(seen))
    for game, difference in enumerate(found):
        own, goals = simulator.games.position[game, 0], simulator.games.goal[game]
        rows = [int(own) * 9 + int(goal) for goal in goals if goal >= 0]
        torch.testing.assert_close(difference, layer.pairs[rows].sum(0))
