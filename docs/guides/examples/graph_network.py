"""A network for graphs: an observation with the edges, and messages along them."""

from functools import cache

import gymnasium
import numpy as np
import torch
from torch import nn

MOST_CELLS = 40  # the same for all graphs, also those of later evaluations


@cache
def cells_after(task):
    """[mazes, MOST_CELLS, moves]: the cell after each move."""
    cells = np.zeros((len(task.mazes), MOST_CELLS, task.num_moves), np.float32)
    for number, maze in enumerate(task.mazes):
        cells[number, : maze.num_cells] = maze.neighbors[:, :-1]
    return cells


class Edges:
    """[MOST_CELLS, 2 + moves]: is the agent, or another, there; the cell after each move."""

    def space(self, task):
        high = np.full((MOST_CELLS, 2 + task.num_moves), MOST_CELLS - 1, np.float32)
        high[:, :2] = 1
        return gymnasium.spaces.Box(0, high, dtype=np.float32)

    def encode(self, task, games, seats):
        count = len(games.steps)
        seen = np.zeros((count, len(seats), MOST_CELLS, 2 + task.num_moves), np.float32)
        seen[..., 2:] = cells_after(task)[games.maze_index][:, None]
        for place, seat in enumerate(seats):
            for other in range(task.num_agents):
                here = np.flatnonzero(games.active[:, other])
                seen[here, place, games.positions[here, other], int(other != seat)] = 1
        return seen


class MessagePassing(nn.Module):
    """Messages that decay with every edge, then what the own cell and its neighbors received."""

    def __init__(self, features, width, channels=8, rounds=16):
        super().__init__()
        self.last_cell, self.rounds = float(features.high.max()), rounds
        moves = features.shape[1] - 2
        self.send = nn.Parameter(torch.randn(2, channels))
        self.decay = nn.Parameter(torch.linspace(-2.0, 1.0, channels))
        self.each = nn.Sequential(nn.Linear(2 * channels + 2, 32), nn.ReLU(), nn.Linear(32, 16))
        self.out = nn.Linear(16 * (moves + 1), width)

    def forward(self, seen):
        places, near = seen[..., :2], (seen[..., 2:] * self.last_cell).round().long()
        edges = torch.zeros(*seen.shape[:2], seen.shape[1]).scatter_(2, near, 1.0)
        edges = edges / edges.sum(dim=2, keepdim=True)
        sent = places @ self.send.exp()
        received, decay = sent, torch.sigmoid(self.decay)
        for _ in range(self.rounds):
            received = sent + decay * (edges @ received)
        logs = (received + 1e-6).log()
        games = torch.arange(seen.shape[0])
        here = places[..., 0].argmax(dim=1)
        around = torch.cat([here[:, None], near[games, here]], dim=1)
        own = logs[games, here][:, None]
        beside = logs[games[:, None], around]
        there = places[games[:, None], around]
        each = self.each(torch.cat([beside - own, own.expand_as(beside), there], dim=2))
        return torch.relu(self.out(torch.relu(each).flatten(1)))
