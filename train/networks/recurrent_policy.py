"""A trained network that remembers, in any seat: no function of what is observed now."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.simulator.policy import GameView, Memory
from pursuit.tasks.task import Task
from train.networks.distributions import masked
from train.networks.frames import FrameStack, shift


def probabilities_of(
    logits: torch.Tensor, allowed: NDArray[np.bool_] | None, greedy: bool
) -> NDArray[np.float64]:
    """[..., actions] float64: the distribution played; of a greedy policy all on one action."""
    if allowed is not None:
        logits = masked(logits, torch.from_numpy(allowed).to(logits.device))
    if greedy:
        chosen = torch.nn.functional.one_hot(logits.argmax(dim=-1), logits.shape[-1])
        return chosen.cpu().double().numpy()
    return logits.double().softmax(dim=-1).cpu().numpy()


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
    """Whether cells have numbers alike in two tasks, for encodings whose shape does not tell."""
    return encoding not in ("index", "positions") or own.max_cells == other.max_cells


def check_looks(
    observations: NDArray[Any], shape: tuple[int, ...], own: Task, view: GameView, encoding: str
) -> None:
    """ValueError unless games look like those of a policy's training.

    Args:
        observations: [games, *shape].
        shape: of one in its training.
        own: the task of its training.
        view: of these games.
        encoding: what is observed.
    """
    if not numbers_fit(encoding, own, view.task):
        raise ValueError(
            f"a policy that observes {encoding!r} in mazes of {own.max_cells} cells; these have "
            f"{view.task.max_cells}. Mazes must be of the size of those of its training (a policy "
            "that observes window:R plays in mazes of any size)"
        )
    if observations.shape[1:] != shape or view.task.num_actions != own.num_actions:
        raise ValueError(
            f"a policy for observations of shape {shape} and {own.num_actions} "
            f"actions; this task gives {observations.shape[1:]} and {view.task.num_actions}. "
            "Agents must be those of its training, and mazes too, or of the same size (a policy "
            "that observes window:R plays in mazes of any size)"
        )


class RecurrentPolicy:
    """A network that fills a seat and remembers; a `MemoryPolicy`.

    It has a GRU, or is given the last observations, or both. What it does depends on
    what it has seen in the episode, so it is no table and no known distribution over what can be
    seen: what it achieves is played out, never solved.

    Args:
        network: gives `logits(observation)`; where it remembers, `remember(observation, state)`
            gives them and the next state, and `sizes` says how many numbers a state has.
        seat: in which it was trained, a `Seat`.
        greedy: take the most probable action; False draws from the distribution.

    Attributes:
        network, seat, greedy: the arguments.
        task, agent, encoding: of the seat.
        memory: of every game "state" [games, numbers] float32, what the network remembers, and
            "frames" [games, frame_stack, *shape], the last observations, the newest first; each
            where there is such a thing.
    """

    def __init__(self, network: Any, seat: Any, greedy: bool = True) -> None:
        self.network, self.seat, self.greedy = network, seat, greedy
        self.task, self.agent, self.encoding = seat.task, seat.agent, seat.encoding
        self.memory = Memory(self._nothing)
        self._recurrent = getattr(network, "policy_memory", None) is not None
        self._stack = FrameStack(seat.seen, seat.frame_stack) if seat.frame_stack > 1 else None

    def _nothing(self, view: GameView) -> dict[str, NDArray[Any]]:
        """The memory of a batch in which nothing has been seen."""
        found: dict[str, NDArray[Any]] = {}
        if self._recurrent:
            found["state"] = np.zeros((view.num_games, self.network.sizes[0]), dtype=np.float32)
        if self._stack is not None:
            found["frames"] = self._stack.begun(view.num_games, view.observe(self.encoding).dtype)
        return found

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Forget all of these games of `view`."""
        kept, rows = self.memory.of(view), view.rows[games]
        if self._recurrent:
            kept["state"][rows] = 0.0
        if self._stack is not None:
            self._stack.forget(kept["frames"], rows)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: the games look different from those that it was trained in.
        """
        observed = view.observe(self.encoding)
        check_looks(observed, self.seat.seen.shape, self.task, view, self.encoding)
        kept, rows = self.memory.of(view), view.rows
        if self._stack is not None:
            frames = kept["frames"][rows]
            shift(frames)
            observed = self._stack.seen(frames, observed)
            kept["frames"][rows] = frames
        device = next(self.network.parameters()).device
        with torch.no_grad():
            given = torch.from_numpy(observed).to(device)
            if self._recurrent:
                before = torch.from_numpy(kept["state"][rows]).to(device)
                logits, state = self.network.remember(given, before)
                kept["state"][rows] = state.cpu().numpy()
            else:
                logits = self.network.logits(given)
        found = probabilities_of(logits, self.seat.masks(view), self.greedy)
        return chosen_from(found, None if self.greedy else view.uniform())
