"""DeviceHook: an `EpisodeHook` for games on a GPU, which begin anew before it hears of it.

What the hook settles of the next episodes is put on the GPU beforehand, in the order in which they
will begin; each game that ends takes what is next. How episodes ended and began is noted there, and
the hook is told after the rollout. So it settles and hears what it does of games on the CPU.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import numpy as np
import torch

from pursuit.rules import layout
from train.environments.device_policies import shared, tensors_at
from train.environments.hooks import EpisodeHook, Foretold

NOTED = {
    "agents": slice(layout.POSITION, layout.EVENT + 1),
    "goals": slice(layout.GOAL, layout.GOAL + 1),
    "clocks": slice(layout.STEPS, layout.MAZE + 1),
    "reals": slice(layout.RETURNS, layout.COLLECTED_GOALS + 1),
}
"""The layers of `layout.Memory` that are noted of a game, beside its flags."""


Notes = list[tuple[bool, tuple[torch.Tensor, ...]]]
"""What was noted, in its order: whether episodes began, and of all games whether they did so (or
ended), their flags and their layers of NOTED."""


class DeviceHook:
    """Stands between a hook and a `DeviceSimulator`.

    A hook that settles things `in_order` is asked before a rollout, and nothing in it waits for the
    GPU. Any other is asked in every step, once it is known how many games begin anew.

    Args:
        simulator: the games.
        hook: what is asked and told; it is shown `simulator.mirror`.

    Raises:
        ValueError: a hook that does not foretell.

    Attributes:
        notes: of what happened, and was not told yet.
    """

    def __init__(self, simulator: Any, hook: EpisodeHook) -> None:
        self.simulator, self.hook = simulator, hook
        self.idle = type(hook) is EpisodeHook
        if not self.idle and type(hook).foretell is EpisodeHook.foretell:
            raise ValueError(
                f"{type(hook).__name__} does not `foretell` what it settles; take device='cpu'"
            )
        self._ahead = False
        self._foretold, self._queues = Foretold(), dict[str, torch.Tensor]()
        device = tensors_at(simulator)
        self._next = torch.zeros((), dtype=torch.int64, device=device)
        self._room = {
            name: shared(simulator, getattr(simulator, name)) for name in ("rows", "seeds", "drawn")
        }
        memory = simulator.memory
        self._live = {
            name: shared(simulator, getattr(memory, name))[:, layers]
            for name, layers in NOTED.items()
            if name != "goals" or simulator.task.num_goals
        }
        self._flags = shared(simulator, memory.flags)
        self.notes: Notes = []

    def begin_rollout(self, steps: int) -> None:
        """Ask what is settled of all episodes that could begin in so many steps."""
        if not self.idle and self.hook.in_order:
            self._take(self.hook.foretell(self.simulator.num_games * (steps + 1)))
            self._ahead = True

    def end_rollout(self) -> None:
        """Tell what happened."""
        self._ahead = False
        self._tell()

    def _take(self, foretold: Foretold) -> None:
        found = {}
        for name, room in self._room.items():
            given = getattr(foretold, name)
            if given is not None:
                queue, kept = torch.from_numpy(np.ascontiguousarray(given)), self._queues.get(name)
                if kept is None or len(kept) != len(queue):
                    kept = torch.empty(len(queue), dtype=room.dtype, device=room.device)
                found[name] = kept.copy_(queue)  # in its place, where a graph looks for it
        self._foretold, self._queues = foretold, found
        self._next.zero_()
        if foretold.settings is not None:
            self.simulator.hold_settings(foretold.settings)

    @property
    def waits(self) -> bool:
        """Whether it asks in every step."""
        return not (self.idle or self.hook.in_order)

    def changed(self) -> list[torch.Tensor]:
        """All that a step changes here."""
        return [self._next]

    def depends(self) -> Hashable:
        """What its launches depend on, beside what lies in the memory of the games."""
        queues = [(name, queue.data_ptr()) for name, queue in self._queues.items()]
        return tuple(queues), self.simulator.held

    def settle(self, games: torch.Tensor) -> None:
        """Give the games of the mask [num_games], which are to begin anew, what is settled."""
        if self.idle:
            return
        if not self._ahead:
            count = int(games.sum())  # waits
            if not count:
                return
            self._take(self.hook.foretell(count))
        place = (self._next + games.cumsum(0) - 1).clamp_(min=0)
        self._next += games.sum()
        for name, queue in self._queues.items():
            room = self._room[name]
            others = room if name == "drawn" else torch.full_like(room, -1)
            room.copy_(torch.where(games, queue[place], others))
        if self._foretold.settings is not None:
            self.simulator.give_settings(self._foretold.settings)
        if self._foretold.seeds is not None:
            self.simulator.give_seeds()

    def ended(self, games: torch.Tensor) -> None:
        """Note how the episodes of the games of the mask [num_games] have just ended."""
        if not self.idle:
            self._note(False, games)

    def begun(self, games: torch.Tensor) -> None:
        """Note how episodes have just begun."""
        if not self.idle:
            self._note(True, games)

    def _note(self, begun: bool, games: torch.Tensor) -> None:
        live = (live.clone() for live in self._live.values())
        self.notes.append((begun, (games.clone(), self._flags.T.clone(), *live)))
        if not self._ahead:
            self._tell()

    def _tell(self) -> None:
        """Tell the hook all that was noted, in its order; it waits for the GPU."""
        ended, begun = (
            iter(self._rows_of([note for of, note in self.notes if of == begins]))
            for begins in (False, True)
        )
        for begins, _ in self.notes:
            games, rows = next(begun if begins else ended)
            if not len(games):
                continue
            if begins:
                self.hook.before_restart(games)
                self.simulator.show(games, rows)
                self.hook.after_restart(games)
            else:
                self.simulator.show(games, rows)
                mask = np.zeros(self.simulator.num_games, dtype=bool)
                mask[games] = True
                self.hook.episode_ended(mask)
        self.notes = []

    def _rows_of(self, notes: list[tuple[torch.Tensor, ...]]) -> list[tuple[Any, dict[Any, Any]]]:
        """Of each note the numbers of its games, and their rows: by (array, layers)."""
        if not notes:
            return []
        masks, *columns = (torch.stack(column) for column in zip(*notes, strict=True))
        steps, games = masks.nonzero(as_tuple=True)
        counts = torch.bincount(steps, minlength=len(notes)).cpu().numpy()
        bounds = np.cumsum(counts)[:-1]
        numbers = np.split(games.cpu().numpy(), bounds)
        names = [("flags", 0), *((name, NOTED[name].start) for name in self._live)]
        parts = [np.split(column[steps, games].cpu().numpy(), bounds) for column in columns]
        return [
            (number, dict(zip(names, rows, strict=True)))
            for number, *rows in zip(numbers, *parts, strict=True)
        ]
