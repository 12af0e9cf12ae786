"""Policies with memory: recurrent networks and stacked observations."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.observations.custom import without_id
from pursuit.simulator.policy import GameView, Memory
from pursuit.tasks.task import Task
from train.networks.distributions import masked
from train.networks.features import observed
from train.networks.frames import FrameStack, Observations, shift
from train.networks.layers import float32_inference


def probabilities_of(
    logits: torch.Tensor, allowed: NDArray[np.bool_] | None, greedy: bool, least: float = 0.0
) -> NDArray[np.float64]:
    """[..., actions] float64: the action probabilities; one-hot for a greedy policy.

    Those of a policy that is not greedy are `without_improbable`.
    """
    if allowed is not None:
        logits = masked(logits, torch.from_numpy(allowed).to(logits.device))
    if greedy:
        chosen = torch.nn.functional.one_hot(logits.argmax(dim=-1), logits.shape[-1])
        return chosen.cpu().double().numpy()
    return without_improbable(logits.double().softmax(dim=-1).cpu().numpy(), least)


def without_improbable(probabilities: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """[..., actions]: probabilities below `least` are 0, and the others scaled to sum 1.

    Where all are below it, they stay as they are.
    """
    if least == 0.0:
        return probabilities
    kept = probabilities >= least
    kept |= ~kept.any(axis=-1, keepdims=True)
    positive = np.where(kept, probabilities, 0.0)
    return np.asarray(positive / positive.sum(axis=-1, keepdims=True))


def chosen_from(
    probabilities: NDArray[np.float64], draws: NDArray[np.float64] | None
) -> NDArray[np.int32]:
    """[games] int32: actions from distributions [games, actions].

    Args:
        probabilities: of each action.
        draws: [games] in [0, 1); None for the most probable action.
    """
    if draws is None:
        return probabilities.argmax(axis=-1).astype(np.int32)
    cumulative = probabilities.cumsum(axis=-1)
    scaled = draws[:, None] * cumulative[:, -1:]
    most = probabilities.shape[-1] - 1
    return (scaled >= cumulative).sum(axis=-1).clip(max=most).astype(np.int32)


def numbers_fit(encoding: str, own: Task, other: Task) -> bool:
    """Whether cell numbers have the same meaning in two tasks, for encodings that contain them."""
    return without_id(encoding) not in ("index", "positions") or own.max_cells == other.max_cells


def check_looks(
    observations: Observations, shape: tuple[int, ...], own: Task, view: GameView, encoding: str
) -> None:
    """ValueError unless the observations have the form of those in a policy's training.

    Args:
        observations: [games, *shape].
        shape: of an observation in training.
        own: the task of the training.
        view: of these games.
        encoding: the observation.
    """
    if not numbers_fit(encoding, own, view.task):
        raise ValueError(
            f"this policy observes {encoding!r} in mazes of {own.max_cells} cells, but these have "
            f"{view.task.max_cells}; use mazes of the size of its training, or a policy that "
            "observes window:R"
        )
    if observations.shape[1:] != shape or view.task.num_actions != own.num_actions:
        raise ValueError(
            f"this policy is for observations of shape {shape} and {own.num_actions} actions, but "
            f"this task has {observations.shape[1:]} and {view.task.num_actions}; use the agents "
            "and the maze size of its training, or a policy that observes window:R"
        )


class RecurrentPolicy:
    """A policy with a recurrent network, stacked observations, or both; a `MemoryPolicy`.

    Its actions depend on the history of the episode, so it has no table: it is evaluated by
    simulation, not exactly.

    Args:
        network: has `logits(observation)`; a recurrent one has `remember(observation, state)`,
            which returns logits and the next state, and `sizes` of its states.
        seat: the `MazeSeat` that it was trained in.
        greedy: the most probable action; False draws from the distribution.

    Attributes:
        network, seat, greedy: the arguments.
        task, agent, encoding: of the seat.
        memory: for every game the recurrent "state" [games, numbers] float32, and the stacked
            "frames" [games, frame_stack, *shape], the newest first; each where it is used.
    """

    def __init__(self, network: Any, seat: Any, greedy: bool = True) -> None:
        self.network, self.seat, self.greedy = network, seat, greedy
        self.task, self.agent, self.encoding = seat.task, seat.agent, seat.encoding
        self.memory = Memory(self._empty_memory)
        self._recurrent = getattr(network, "policy_memory", None) is not None
        self._stack = FrameStack(seat.seen, seat.frame_stack) if seat.frame_stack > 1 else None

    def _empty_memory(self, view: GameView) -> dict[str, Observations]:
        """The empty memory of a batch of games."""
        empty: dict[str, Observations] = {}
        if self._recurrent:
            empty["state"] = np.zeros((view.num_games, self.network.sizes[0]), dtype=np.float32)
        if self._stack is not None:
            dtype = observed(view, self.encoding).dtype
            empty["frames"] = self._stack.empty_frames(view.num_games, dtype)
        return empty

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Reset the memory of these games of `view`."""
        kept, rows = self.memory.of(view), view.rows[games]
        if self._recurrent:
            kept["state"][rows] = 0.0
        if self._stack is not None:
            self._stack.forget(kept["frames"], rows)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32: actions; draws use the random stream of the view.

        Raises:
            ValueError: observations other than in training.
        """
        seen = observed(view, self.encoding)
        check_looks(seen, self.seat.seen.shape, self.task, view, self.encoding)
        kept, rows = self.memory.of(view), view.rows
        if self._stack is not None:
            frames = kept["frames"][rows]
            shift(frames)
            seen = self._stack.with_newest(frames, seen)
            kept["frames"][rows] = frames
        device = next(self.network.parameters()).device
        with float32_inference(self.network):
            observation = torch.from_numpy(seen).to(device)
            if self._recurrent:
                before = torch.from_numpy(kept["state"][rows]).to(device)
                logits, state = self.network.remember(observation, before)
                kept["state"][rows] = state.cpu().numpy()
            else:
                logits = self.network.logits(observation)
        allowed, least = self.seat.masks(view), self.seat.min_probability
        probabilities = probabilities_of(logits, allowed, self.greedy, least)
        return chosen_from(probabilities, None if self.greedy else view.uniform())
