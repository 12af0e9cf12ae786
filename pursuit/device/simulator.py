"""DeviceSimulator: the games of a `Simulator` on a GPU."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numba import config, cuda
from numpy.typing import ArrayLike, NDArray

from pursuit import next_episode, rules
from pursuit.declared import whole
from pursuit.device.calls import Call, call_of
from pursuit.device.checks import check_task, choose_device, on_device
from pursuit.device.kernels import Batch, Launch
from pursuit.device.waiting import Settings, take_epsilon, take_seeds, take_settings
from pursuit.maze_arrays import lay_out
from pursuit.rules import layout
from pursuit.task import Task

STEP_WORK = ("rules", layout.SCRATCH_LAYERS)


class DeviceSimulator:
    """Any number of games of one task, stepped in lockstep on a GPU: `Simulator(device="cuda")`.

    The kernels are those of the CPU, compiled for the GPU, one thread a game; with the same seed
    the games are the same, bit for bit. `step`, `act`, `observe` and `reset` (without a seed) wait
    for nothing: they put kernels in a stream. So nothing is raised by them that only the GPU finds
    out; `check` waits, and raises it. Where the settings hold chasers and evaders apart, or
    together, at the start, a step and a reset do wait for one number: rare starts that no try
    finds are counted out on the CPU.

    Everything else (`configure`, `seed`, `get_state`, ...) copies all games to the CPU and back; it
    is for the times between rollouts. What is to change within one, as games begin anew, is given
    them by `give_settings` and `give_seeds`.

    Args:
        host: the games, on the CPU, where they begin.
        device: "cuda", or "cuda:1" and so on.

    Raises:
        ValueError: no GPU, or no numba-cuda, is found; or a task whose rewards the kernels do not
            pay, or would round otherwise than the CPU does.

    Attributes (arrays of the GPU, with `__cuda_array_interface__`, which steps overwrite in place):
        memory: all arrays of the games, as `pursuit.rules.layout.Memory` says; the functions of
            that file name what lies in them, of arrays of any library that are made of these.
        actions: [num_games, num_agents] int32, what `act` fills and what `step` takes by default.
        chosen: [num_games] bool, room for a mask that `reset` is to be given.
        rows: [num_games] int32, room for what `give_settings` is to give whom.
        seeds: [num_games] int64, room for what `give_seeds` is to give whom.
        drawn: [num_games] int32, which of several policies plays in each game, where there are
            several (`Launch(chosen=True)`).
        held: rows that there is room for on the GPU for settings; with more they lie elsewhere.
        waits: whether steps and resets wait for a number: where starts can be rare.
        task, num_games, num_agents, first_game, auto_restart, last_seed: as in `Simulator`.
        stream: the number of a CUDA stream (torch: `torch.cuda.current_stream().cuda_stream`);
            assign it to have all that follows run there. 0 is the default stream.
        simulated: whether there is no GPU, but Numba's simulator of one in Python.
    """

    simulated = bool(config.ENABLE_CUDASIM)

    def __init__(self, host: Any, device: str = "cuda") -> None:
        choose_device(device)
        self._host, self.device = host, device
        self.task: Task = host.task
        self.num_games, self.num_agents = host.num_games, host.num_agents
        self.first_game, self.auto_restart = host.first_game, host.auto_restart
        check_task(self.task)
        arrays, task = host._kernel_arrays, self.task
        memory = layout.Memory(*arrays[: len(layout.Memory._fields)])
        room = max(task.max_cells, task.num_agents, task.num_goals)
        self._batch = Batch(memory, lay_out(task.mazes), room)
        self.memory = self._batch.memory
        self.actions = cuda.to_device(np.zeros((self.num_games, self.num_agents), np.int32))
        numbers = {"numbers": task.numbers_for_kernels(), "pay": task.rewards_for_kernels()}
        step = Call(rules.step_games_of(task.teams), numbers, "actions", STEP_WORK)
        start = Call(rules.start_games, numbers, "chosen", STEP_WORK)
        self._step, self._start = Launch(step, self._batch), Launch(start, self._batch)
        self._all = cuda.to_device(np.ones(self.num_games, dtype=bool))
        self.chosen = cuda.to_device(np.zeros(self.num_games, dtype=bool))
        self.rows = cuda.to_device(np.full(self.num_games, -1, dtype=np.int32))
        self.seeds = cuda.to_device(np.full(self.num_games, -1, dtype=np.int64))
        self.drawn = cuda.to_device(np.zeros(self.num_games, dtype=np.int32))
        self._take_settings = Launch(Call(take_settings, writes="rows"), self._batch)
        self._take_seeds = Launch(Call(take_seeds, writes="seeds"), self._batch)
        self._take_epsilon = Launch(Call(take_epsilon, writes="shares"), self._batch)
        self._seats: dict[tuple[int, int], tuple[Any, Launch]] = {}
        self._encodings: dict[Any, tuple[Any, Any, Any, list[Launch]]] = {}
        self._stream, self._found = 0, np.zeros(3, dtype=bool)
        self._given: tuple[Any, dict[str, Any]] = (None, {})
        self.held = 0
        self.waits = self._finds_distances()

    # -- the arrays under their names --------------------------------------------------------------

    @property
    def games(self) -> layout.Games:
        """The games under the names of the rule book, arrays of the GPU."""
        return layout.named(layout.games_of, self.memory)

    @property
    def outcome(self) -> layout.Outcome:
        """What steps led to: rewards, flags, the ends of episodes; arrays of the GPU."""
        return layout.named(layout.outcome_of, self.memory)

    @property
    def last_seed(self) -> int | None:
        """As in `Simulator`."""
        seed: int | None = self._host.last_seed
        return seed

    @property
    def stream(self) -> int:
        """See the attributes."""
        return self._stream

    @stream.setter
    def stream(self, number: int) -> None:
        if number != self._stream:
            self._stream = whole("stream", number, 0)
            self._batch.stream = cuda.external_stream(number) if number else 0

    # -- playing -----------------------------------------------------------------------------------

    def step(self, actions: Any = None) -> None:
        """Move every game by one step; an action out of range moves nobody of its game.

        Args:
            actions: [num_games, num_agents] int32 on the GPU (whatever has
                `__cuda_array_interface__`), or an array of the CPU, which is copied; `self.actions`
                where left out.

        Raises:
            ValueError: a wrong shape or dtype.
        """
        given = self.actions if actions is None else self._taken("actions", actions, self.actions)
        self._step(actions=given, auto_restart=self.auto_restart)
        self._place_rare_starts()

    def reset(self, seed: int | None = None, games: Any = None) -> None:
        """Begin new episodes in all games, or in those of a mask.

        Args:
            seed: of these games; it takes the way over the CPU.
            games: [num_games] bool on the GPU; or a mask or an index list on the CPU.

        Raises:
            ValueError: a seed or game out of range.
        """
        if seed is not None or not (games is None or on_device(games)):
            with self._on_host() as host:
                host.reset(seed, games)
            return
        chosen = self._all if games is None else self._taken("games", games, self._all)
        self._start(chosen=chosen)
        self._place_rare_starts()

    def act(self, policies: Sequence[Any], actions: Any = None) -> None:
        """Write the action of every seat that has a policy into `actions` [games, agents].

        Args:
            policies: a policy or None a seat. It must have `on_device(task, seat, mazes)`, which
                says by which kernel it plays (`pursuit.device.calls.Call`): the scripted agents of
                full sight and tables have it.
            actions: on the GPU; `self.actions` where left out.

        Raises:
            ValueError: another number of seats, or a policy that does not play on a GPU.
        """
        if len(policies) != self.num_agents:
            raise ValueError(f"{len(policies)} policies for {self.num_agents} seats; one each")
        given = self.actions if actions is None else self._taken("actions", actions, self.actions)
        for seat, policy in enumerate(policies):
            if policy is not None:
                self._launch_of(seat, policy)(actions=given, seat=seat)

    def hold_settings(self, settings: Settings) -> None:
        """Copy settings that are to be given to the GPU, in the place of those before them."""
        self.waits = self.waits or settings.distances
        if settings is self._given[0]:
            return
        rows, held = settings.num_games, self._given[1]
        room = max(self.held, 1 << (rows - 1).bit_length())
        more, none = (0, room - rows), (0, 0)
        numbers, shares = settings.numbers, settings.shares
        arrays = {"numbers": np.pad(numbers, (none, more)), "shares": np.pad(shares, (more, none))}
        for name, array in arrays.items():
            if room > self.held:
                held[name] = cuda.to_device(array)
            else:
                held[name].copy_to_device(array)
        self._given, self.held = (settings, held), room

    def give_settings(self, settings: Settings) -> None:
        """Have the next episodes begin with settings: of each game the row in `self.rows`, if >= 0.

        It waits for nothing where these are held.
        """
        self.hold_settings(settings)
        self._take_settings(rows=self.rows, **self._given[1])

    def give_seeds(self) -> None:
        """Make the next starts those of the seeds in `self.seeds`, where these are >= 0.

        It is `Simulator.seed_starts`, and waits for nothing.
        """
        self._take_seeds(seeds=self.seeds)

    def array(self, given: NDArray[Any]) -> Any:
        """A copy on the GPU, for `launch`."""
        return cuda.to_device(given)

    def launch(self, call: Call, seat: int | None = None, chosen: bool = False) -> Launch:
        """A kernel over these games, to be run at any time, in the stream of the games.

        Args:
            call: which.
            seat: whose actions it writes, where it does.
            chosen: as in `Launch`.
        """
        return Launch(call, self._batch, of_seat=seat is not None, chosen=chosen)

    def _launch_of(self, seat: int, policy: Any) -> Launch:
        key = (seat, id(policy))
        if key not in self._seats:
            call = call_of(policy, self.task, seat, lay_out(self.task.mazes))
            # The policy is kept, so that its id is not given to another.
            self._seats[key] = policy, Launch(call, self._batch, of_seat=True)
        return self._seats[key][1]

    def observe(
        self, encoding: str = "one_hot", seat: int | str | slice | None = None, final: bool = False
    ) -> Any:
        """What the agents observe now, on the GPU: one array for each way to ask, written anew.

        Args:
            encoding: one of those of `pursuit.observations.Encoder`, none of your own.
            seat: of one agent, [num_games, ...]; a slice of seats or None for all of them,
                [num_games, seats, ...].
            final: of the last finished episode as it ended.

        Raises:
            ValueError: an unknown encoding, or one of your own.
        """
        one = seat is not None and not isinstance(seat, slice)
        first = self.task.seat(seat) if one else 0  # type: ignore[arg-type]
        seats: Any = slice(first, first + 1) if one else seat or slice(None)
        key = (encoding, seats.start, seats.stop, one, final)
        if key not in self._encodings:
            encoder = self._host.encoder(encoding)
            launches = [Launch(call, self._batch, final) for call in encoder.calls(seats)]
            rows = (self.num_games, len(range(self.num_agents)[seats]))
            out = cuda.to_device(np.zeros((*rows, *encoder.flat_shape), encoder.dtype))
            shown = out.reshape(self.num_games, *rows[1 + one :], *encoder.shape)
            self._encodings[key] = (
                out,
                out.reshape(*rows, math.prod(encoder.shape)),
                shown,
                launches,
            )
        out, flat, shown, launches = self._encodings[key]
        for launch in launches:
            launch(out=out, flat=flat)
        return shown

    # -- what waits --------------------------------------------------------------------------------

    def check(self) -> None:
        """Wait for the GPU, and raise what was found since the last time.

        Raises:
            ValueError: an action was out of range. Its game stood still in that step.
        """
        if self._noted(layout.BAD_ACTION):
            raise ValueError(
                f"an action was out of range; actions are 0 to {self.task.num_actions - 1}"
                + ("" if self.task.stay_action else " (4, stay, needs stay_action=True)")
            )

    def _noted(self, code: int) -> bool:
        """Whether any kernel has returned a code since this was last asked; it waits for them."""
        cuda.synchronize()
        notes = self._batch.notes.copy_to_host()
        self._batch.notes.copy_to_device(np.zeros_like(notes))
        self._found |= notes != 0
        found, self._found[code] = bool(self._found[code]), False
        return found

    def _place_rare_starts(self) -> None:
        """Choose the starts that no try found, where the settings make such starts possible."""
        if self.waits and self._noted(layout.NO_PLACEMENT):
            with self._on_host() as host:
                host._check(layout.NO_PLACEMENT)

    def _finds_distances(self) -> bool:
        coming = self._host._coming
        least, most = coming.min_start_distance, coming.max_start_distance
        return bool((least > 1).any() or (most >= 0).any())

    @contextmanager
    def _on_host(self, change: bool = True) -> Iterator[Any]:
        """The games on the CPU, as they are on the GPU; what is done to them there comes back."""
        cuda.synchronize()
        pairs = zip(self._host._kernel_arrays, self.memory, strict=False)
        arrays = [(here, there) for here, there in pairs if here.size]
        for here, there in arrays:
            there.copy_to_host(here)
        yield self._host
        if change:
            for here, there in arrays:
                there.copy_to_device(here)
            cuda.synchronize()
            self.waits = self._finds_distances()

    @property
    def mirror(self) -> Any:
        """A `Simulator` on the CPU: what was last copied there, or put there by `show`."""
        return self._host

    def show(self, games: NDArray[np.intp], rows: Mapping[tuple[str, int], NDArray[Any]]) -> None:
        """Put rows of the games' memory into `mirror`, for whoever is to see them there.

        Args:
            games: [n].
            rows: [n, layers, ...] by array of `layout.Memory` and its first layer.
        """
        memory = layout.Memory(*self._host._kernel_arrays[: len(layout.Memory._fields)])
        for (name, first), values in rows.items():
            own = getattr(memory, name)
            if name == "flags":
                own[:, games] = values.T
            else:
                own[games, first : first + values.shape[1]] = values

    def host(self) -> Any:
        """The games on the CPU as they are now: a `Simulator`, which the next call overwrites."""
        with self._on_host(change=False) as host:
            return host

    def configure(self, games: ArrayLike | None = None, **settings: Any) -> None:
        """As `Simulator.configure`."""
        with self._on_host() as host:
            host.configure(games, **settings)

    def set_epsilon(self, shares: ArrayLike) -> None:
        """As assigning `Simulator.epsilon`; the games stay where they are."""
        each = np.empty((self.num_games, self.num_agents))
        next_episode.fill("epsilon", each, next_episode.checked_shares(shares))
        self._take_epsilon(shares=cuda.to_device(each))

    def seed(self, seed: int, games: ArrayLike | None = None) -> None:
        """As `Simulator.seed`."""
        with self._on_host() as host:
            host.seed(seed, games)

    def seed_starts(self, games: ArrayLike | None, seeds: ArrayLike) -> None:
        """As `Simulator.seed_starts`."""
        with self._on_host() as host:
            host.seed_starts(games, seeds)

    def place(self, *given: Any, **settings: Any) -> None:
        """As `Simulator.place`."""
        with self._on_host() as host:
            host.place(*given, **settings)

    def get_state(self, games: ArrayLike | None = None) -> Any:
        """As `Simulator.get_state`: on the CPU, and good for a `Simulator` there."""
        return self.host().get_state(games)

    def set_state(self, state: Any, games: ArrayLike | None = None) -> None:
        """As `Simulator.set_state`."""
        with self._on_host() as host:
            host.set_state(state, games)

    def encoder(self, encoding: str) -> Any:
        """As `Simulator.encoder`: for the space of an encoding."""
        return self._host.encoder(encoding)

    def _taken(self, name: str, given: Any, like: Any) -> Any:
        """What a kernel takes: an array on the GPU of the shape and dtype of `like`."""
        array = given
        if not on_device(given):
            array = np.ascontiguousarray(given)
            if array.dtype.kind in "iu" and like.dtype == np.int32:
                array = np.clip(array, -1, self.task.num_actions).astype(np.int32)
        elif not hasattr(given, "copy_to_host"):
            array = cuda.as_cuda_array(given, sync=False)
        if tuple(array.shape) != tuple(like.shape) or array.dtype != like.dtype:
            raise ValueError(
                f"{name} of shape {tuple(array.shape)} and dtype {array.dtype}; give "
                f"{tuple(like.shape)} and {like.dtype}"
            )
        return array if on_device(given) else cuda.to_device(array)
