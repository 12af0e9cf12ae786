"""`Batch`: games stepped together, the base of all simulators; and what it knows of a task."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.rules.arrays import Array
from pursuit.rules.randomness import seed_starts, seed_streams, uniform_numbers
from pursuit.simulator.next_episode import fill, game_indices
from pursuit.simulator.state import SimulatorState, check_arrays
from pursuit.validation import check, check_bool, checked_seed, unknown, whole, whole_numbers


class Rules(Protocol):
    """What is known of any task: of games in mazes, of small games, of arms, of one's own.

    A class that derives from it gives `name`, `max_steps` and `agent_names`, and inherits the rest.

    Attributes:
        name: in results and messages.
        max_steps: steps (rounds) after which an episode is truncated.
        steps_per_round: 2 where two sides move in turns, else 1.
        agent_names: of all agents, in their order.
        seat_roles: the role of each; its name where agents have no roles.
    """

    @property
    def name(self) -> str: ...  # noqa: D102 -- see the class
    @property
    def max_steps(self) -> int: ...  # noqa: D102
    @property
    def steps_per_round(self) -> int:  # noqa: D102
        return 1

    @property
    def agent_names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def seat_roles(self) -> tuple[str, ...]:  # noqa: D102
        return self.agent_names

    @property
    def num_agents(self) -> int:  # noqa: D102
        return len(self.agent_names)

    def seat(self, agent: str | int) -> int:
        """The index of an agent by name, role (the first of it) or index; ValueError if there is
        none."""
        if isinstance(agent, str):
            known = [*self.agent_names, *self.seat_roles]
            check(agent in known, unknown("agent", agent, dict.fromkeys(known)))
            return known.index(agent) % self.num_agents
        return whole("agent", agent, 0, self.num_agents - 1)


AnyTask = TypeVar("AnyTask", bound=Rules)
Arrays = tuple[Array, ...]


class Batch(ABC, Generic[AnyTask]):
    """A batch of games of one task, stepped together: seeds, restarts, saved states and copies.

    All environments, training and evaluation play on it. Subclasses implement `step`, `view` and
    the methods below, set these arrays and `_arrays`, and call `reset` at the end of their
    constructor.

    Args:
        task, num_games, seed, first_game, auto_restart: as of `pursuit.Simulator`.

    Raises:
        ValueError: counts or seeds out of range.

    Attributes (live arrays):
        streams: [num_games, ...] uint64, the random streams.
        rewards: [num_games, agents] float32, of the last step; of an arm [num_games].
        returns: likewise float64, the sum of rewards of the episode so far.
        terminated, truncated: [num_games] bool, of the last step; never both.
        PLAYS_TABLES: whether games of two can be played by tables, as `GameSimulator.play` does.
    """

    PLAYS_TABLES: ClassVar[bool] = False
    streams: NDArray[np.uint64]
    rewards: NDArray[np.float32]
    returns: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    _arrays: Arrays
    """All arrays that `step`, `reset`, `seed` and `configure` change."""

    def __init__(
        self, task: AnyTask, num_games: int, seed: int, first_game: int, auto_restart: bool
    ) -> None:
        self.task, self.num_games = task, whole("num_games", num_games, 1, 2**63 - 1)
        self.first_game = whole("first_game", first_game, 0, 2**62)
        checked_seed(seed)
        self.auto_restart = check_bool("auto_restart", auto_restart)
        self.last_seed: int | None = None

    @property
    @abstractmethod
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps of the episode so far."""

    @abstractmethod
    def step(self, actions: ArrayLike) -> None:
        """Step all games with the actions of all agents; ValueError for invalid ones."""

    def view(self, seat: int | str) -> Any:
        """The games as the policy of an agent sees them; live."""
        return SeatView(self, self.task.seat(seat), self.streams)

    def text(self, game: int) -> str:
        """A game as text, for pictures and pages of games that are not drawn: its state, without
        random streams."""
        hidden = ("streams", "terminated", "truncated", "returns", "steps")
        live = {name: array for name, array in self._live().items() if name not in hidden}
        return "\n".join(
            f"{name}: {np.asarray(array[game]).tolist()}" for name, array in live.items()
        )

    def act(self, policies: Sequence[Any], actions: NDArray[np.int32]) -> None:
        """Write the actions of all agents with a policy into `actions` [games, agents]."""
        for seat, policy in enumerate(policies):
            if policy is not None:
                actions[:, seat] = policy.act(self.view(seat))

    @abstractmethod
    def _start(self, chosen: NDArray[np.bool_]) -> None:
        """Start new episodes in the games of a mask."""

    @abstractmethod
    def _live(self) -> dict[str, Array]:
        """The live arrays that make up the state."""

    def _check_values(self, state: SimulatorState) -> None:
        """Raise ValueError unless the values of a state, whose arrays fit, are possible."""

    @property
    def ended(self) -> NDArray[np.bool_]:
        """[num_games] bool, a new array: terminated or truncated in the last step."""
        return self.terminated | self.truncated

    def seed(self, seed: int, games: ArrayLike | None = None) -> None:
        """Seed the random streams of each game with (seed, game index).

        Args:
            seed: 0 to 2**64 - 1.
            games: a bool mask or index list; default: all.

        Raises:
            ValueError: a seed or game out of range.
        """
        seed, chosen = checked_seed(seed), game_indices(games, self.num_games)
        fresh = np.empty_like(self.streams)
        seed_streams(fresh, self._seed_of_streams(seed), self.first_game)
        self.streams[chosen] = fresh[chosen]
        self.last_seed = seed if games is None else None

    def _seed_of_streams(self, seed: int) -> np.uint64:
        return np.uint64(seed)

    def reset(self, seed: int | None = None, games: ArrayLike | None = None) -> None:
        """Start new episodes in all games, or in those of the bool mask or index list `games`.

        A seed applies to these games only.

        Raises:
            ValueError: a seed or game out of range.
        """
        chosen = np.zeros(self.num_games, dtype=bool)
        chosen[game_indices(games, self.num_games)] = True
        if seed is not None:
            self.seed(seed, games)
        self._start(chosen)

    def seed_starts(self, games: ArrayLike | None, seeds: ArrayLike) -> None:
        """Seed the starts: the next start of each game depends on its seed (and settings) only.

        Later starts continue the stream of this seed. Other random streams do not change.

        Args:
            games: a bool mask or index list; None for all.
            seeds: one whole number from 0 to 2**63 - 1 for all games, or one for each.

        Raises:
            ValueError: a seed out of range, or a wrong number of them.
        """
        chosen = game_indices(games, self.num_games)
        each = np.zeros(len(chosen), dtype=np.uint64)
        fill("seeds", each, whole_numbers("seeds", seeds, 0, 2**63 - 1))
        seed_starts(self.streams, chosen, each)

    def get_state(self, games: ArrayLike | None = None) -> SimulatorState:
        """Exact copies of the states of all games, or of those of the index list `games`."""
        chosen = game_indices(games, self.num_games)
        state = SimulatorState(**{name: array[chosen] for name, array in self._live().items()})
        if self.auto_restart:  # these games have already restarted
            state.terminated[:] = state.truncated[:] = False
        return state

    def set_state(self, state: SimulatorState, games: ArrayLike | None = None) -> None:
        """Restore copied states in all games, or in those of `games`.

        Raises:
            ValueError: a different number of games or another task, or an ended game in a simulator
                with `auto_restart`. Nothing is changed then.
        """
        chosen, live = game_indices(games, self.num_games), self._live()
        check_arrays(state, live, len(chosen))
        self._check_values(state)
        if self.auto_restart and (state.terminated | state.truncated).any():
            raise ValueError("the episode of a game has ended; reset it, or use auto_restart=False")
        for name, array in live.items():
            array[chosen] = getattr(state, name)
        self.last_seed = None

    def __reduce__(self) -> tuple[Any, ...]:
        """For `copy` and `pickle`, which would otherwise separate arrays that share memory."""
        batch = (self.task, self.num_games, 0, self.first_game, self.auto_restart)
        return _copied, (type(self), batch, self._arrays)


def _copied(kind: type[Any], batch: tuple[Any, ...], arrays: Arrays) -> Any:
    simulator = kind(*batch)
    simulator.last_seed = None
    for array, copied in zip(simulator._arrays, arrays, strict=True):
        array[:] = copied
    return simulator


@dataclass(frozen=True, eq=False)
class SeatView:
    """Games of any kind as the policy of an agent sees them.

    Attributes:
        batch: all games, live.
        seat: the index of the agent.
        streams: [num_games, ...] uint64, the random streams, the last of which are those of the
            agents in their order; a policy draws from its own stream only.
        games: [num_games] which games these are; None for all.
    """

    batch: Batch[Any]
    seat: int
    streams: NDArray[np.uint64]
    games: NDArray[np.intp] | None = None

    @property
    def task(self) -> Any:
        """The task of the games."""
        return self.batch.task

    @property
    def num_games(self) -> int:
        """Number of games in the view."""
        return len(self.streams)

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps of the episode so far."""
        return self.of(lambda batch: batch.steps)

    def of(self, function: Callable[[Batch[Any]], Array]) -> Array:
        """[num_games, ...] those rows of a function of the batch [all games, ...]."""
        found = function(self.batch)
        return found if self.games is None else found[self.games]

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), from the agent's own random stream, which advances."""
        first = self.streams.shape[1] - self.task.num_agents
        return uniform_numbers(self.streams, first + self.seat)

    def select(self, games: NDArray[np.intp]) -> SeatView:
        """A view of these games, with copies of the random streams."""
        own = games if self.games is None else self.games[games]
        return SeatView(self.batch, self.seat, self.streams[games], own)
