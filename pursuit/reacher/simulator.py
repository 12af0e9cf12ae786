"""The class `ReacherSimulator`, which steps batches of arms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.memory import check_memory
from pursuit.reacher import rules
from pursuit.reacher.observations import encode
from pursuit.reacher.policy import ArmView
from pursuit.reacher.rules import Arms, NextEpisode, Outcome
from pursuit.reacher.state import check_fits
from pursuit.reacher.task import LEAST_TOLERANCE, ReacherTask
from pursuit.simulator.next_episode import slots
from pursuit.simulator.state import SimulatorState
from pursuit.validation import as_array, check_bool, whole


class ReacherSimulator:
    """A batch of arms of one task, stepped together by compiled kernels.

    As in `pursuit.Simulator`, an arm restarts in the step that ends its episode, and the results of
    that episode remain available. Arm i of a batch with seed s is identical to a single arm with
    `seed=s, first_game=i`.

    Args:
        task: the task.
        num_games: number of arms in the batch.
        seed: 0 to 2**64 - 1.
        first_game: the index of the first arm of this batch.
        auto_restart: if False, arms keep their final state and flags until `reset`.

    Raises:
        ValueError: counts or seeds out of range, or not enough memory.

    Attributes (arrays that every step overwrites in place; copy them to keep them):
        arms: the state of the arms.
        angles: [num_games, joints] float64, radians in [-pi, pi), relative to the link before.
        targets, tips: [num_games, 2] float64; the base is at (0, 0).
        ends: [num_games, joints, 2] float64, the end of every link.
        held, steps: [num_games] int32, consecutive steps in reach; steps of the episode.
        rewards: [num_games] float32, of the last step.
        returns: [num_games] float64, the sum of rewards of the episode so far.
        terminated, truncated: [num_games] bool, of the last step; never both.
        episode_returns: [num_games] float64, of each arm's last finished episode.
        episode_lengths: [num_games] int32, likewise.
        final: the state of the arms at the end of those episodes.
        streams: [num_games, 2] uint64, the random streams.
        last_seed: the last seed of all streams; None after `set_state`.
    """

    def __init__(
        self,
        task: ReacherTask,
        num_games: int = 1,
        seed: int = 0,
        first_game: int = 0,
        auto_restart: bool = True,
    ) -> None:
        if not isinstance(task, ReacherTask):
            raise ValueError(f"task={task!r}; give a pursuit.ReacherTask")
        num_games = whole("num_games", num_games, 1, 2**63 - 1)
        first_game = whole("first_game", first_game, 0, 2**62)
        seed, auto_restart = (
            whole("seed", seed, 0, 2**64 - 1),
            check_bool("auto_restart", auto_restart),
        )
        needed = num_games * (2 * 8 * (3 * task.joints + 4) + 128)
        check_memory(f"num_games={num_games}", needed, "take fewer games")
        self.task, self.num_games = task, num_games
        self.first_game, self.auto_restart = first_game, auto_restart
        self.arms, self.final = _arms(task, num_games), _arms(task, num_games)
        self._coming = NextEpisode(
            fresh=np.ones(num_games, dtype=bool),
            distance=np.full(num_games, rules.UNCHANGED),
            free_joints=np.full(num_games, -1, dtype=np.int32),
            hold=np.full(num_games, -1, dtype=np.int32),
            tolerance=np.full(num_games, rules.UNCHANGED),
        )
        self.rewards = np.zeros(num_games, dtype=np.float32)
        self.returns, self.episode_returns = np.zeros(num_games), np.zeros(num_games)
        self.terminated, self.truncated = (np.zeros(num_games, dtype=bool) for _ in range(2))
        self.episode_lengths = np.zeros(num_games, dtype=np.int32)
        self.streams = np.zeros((num_games, rules.NUM_STREAMS), dtype=np.uint64)
        outcome = Outcome(
            self.rewards,
            self.returns,
            self.episode_returns,
            self.terminated,
            self.truncated,
            self.episode_lengths,
            self.final,
        )
        self._kernel_arrays = (
            *self.arms,
            *outcome[:-1],
            *self.final,
            *self._coming,
            self.streams,
            *task.numbers_for_kernels,
        )
        self.angles: NDArray[np.float64] = self.arms.angles
        self.targets: NDArray[np.float64] = self.arms.target
        self.ends: NDArray[np.float64] = self.arms.ends
        self.tips: NDArray[np.float64] = self.arms.ends[:, -1]
        self.held: NDArray[np.int32] = self.arms.held
        self.steps: NDArray[np.int32] = self.arms.steps
        self._view = ArmView(task, self.arms, self.streams, self.observe)
        self.last_seed: int | None = None
        self.reset(seed)

    @property
    def ended(self) -> NDArray[np.bool_]:
        """[num_games] bool, a new array: terminated or truncated in the last step."""
        return self.terminated | self.truncated

    def seed(self, seed: int, games: ArrayLike | None = None) -> None:
        """Seed the random streams of each arm with (seed, arm); the next pose is drawn.

        Args:
            seed: 0 to 2**64 - 1.
            games: a bool mask or index list; default: all.

        Raises:
            ValueError: a seed or arm out of range.
        """
        seed, chosen = whole("seed", seed, 0, 2**64 - 1), slots(games, self.num_games)
        fresh = np.empty_like(self.streams)
        rules.seed_arms(fresh, np.uint64(seed), self.first_game)  # type: ignore[arg-type]
        self.streams[chosen] = fresh[chosen]
        self._coming.fresh[chosen] = True
        self.last_seed = seed if games is None else None

    def reset(self, seed: int | None = None, games: ArrayLike | None = None) -> None:
        """Start new episodes in all arms, or in those of the bool mask or index list `games`.

        A seed applies to these arms only. With a seed, start poses are drawn even if the task keeps
        poses.

        Raises:
            ValueError: a seed or arm out of range.
        """
        chosen = np.zeros(self.num_games, dtype=bool)
        chosen[slots(games, self.num_games)] = True
        if seed is not None:
            self.seed(seed, games)
        rules.start_arms(chosen, *self._kernel_arrays)

    def step(self, actions: ArrayLike) -> None:
        """Step all arms. Results are in the attributes.

        Args:
            actions: [num_games, joints] floats in [-1, 1].

        Raises:
            ValueError: a wrong shape or dtype, a number out of range, or NaN. Then no arm moves.
        """
        shape = (self.num_games, self.task.joints)
        turns = as_array("actions", actions, "fiu", "give floats in [-1, 1]")
        if turns.shape != shape:
            raise ValueError(f"actions of shape {turns.shape}; [num_games, joints] is {shape}")
        turns = np.ascontiguousarray(turns, dtype=np.float64)
        if rules.step_arms(turns, self.auto_restart, *self._kernel_arrays) == rules.BAD_ACTION:
            arm, joint = np.argwhere(~(np.abs(turns) <= 1.0 + rules.ROUNDING))[0]
            raise ValueError(
                f"an action of joint {joint} of arm {arm} is {turns[arm, joint]}; it must be "
                "in [-1, 1]: clip it, or scale it"
            )

    # -- the next episode ------------------------------------------------------------------------

    def configure(
        self,
        games: ArrayLike | None = None,
        *,
        target_distance: ArrayLike | None = None,
        free_joints: ArrayLike | None = None,
        hold: ArrayLike | None = None,
        tolerance: ArrayLike | None = None,
    ) -> None:
        """Change settings of all arms, or of `games`, from their next restart on.

        Args:
            games: a bool mask or index list; default: all.
            target_distance: the target is reachable in this number of steps: it is the tip of a
                pose with all joints turned by uniform random angles within that range. -1, or
                enough steps for half a turn, is no limit.
            free_joints: number of joints that turn; later joints are locked straight.
            hold: as in `ReacherTask`.
            tolerance: as in `ReacherTask`.

        Raises:
            ValueError: a value out of range; nothing is changed then.
        """
        chosen, task = slots(games, self.num_games), self.task
        given: dict[str, tuple[ArrayLike | None, float, float]] = {
            "target_distance": (target_distance, -1.0, 1e9),
            "free_joints": (free_joints, 1, task.joints),
            "hold": (hold, 1, task.max_steps),
            "tolerance": (tolerance, LEAST_TOLERANCE, 2.0 * task.joints),
        }
        waiting: dict[str, NDArray[Any]] = {}
        for name, (value, least, most) in given.items():
            if value is None:
                continue
            field = name.removeprefix("target_")
            live = getattr(self._coming, field)
            whole_only = live.dtype.kind == "i"
            rule = f"{'whole numbers' if whole_only else 'numbers'} from {least} to {most}"
            numbers = as_array(name, value, "iu" if whole_only else "iuf", rule)
            if not ((numbers >= least) & (numbers <= most)).all():
                raise ValueError(f"{name}={value!r}; {rule}")
            try:
                waiting[field] = np.broadcast_to(numbers, chosen.shape)
            except ValueError:
                raise ValueError(f"{name}={value!r}; give one number, or one per arm") from None
        for name, numbers in waiting.items():
            getattr(self._coming, name)[chosen] = numbers

    def seed_starts(self, games: ArrayLike | None, seeds: ArrayLike) -> None:
        """Seed the starts: the next pose and target of each arm depend on its seed only.

        Args:
            games: a bool mask or index list; None for all.
            seeds: one whole number from 0 to 2**63 - 1 for all arms, or one for each.

        Raises:
            ValueError: a seed out of range, or a wrong number of them.
        """
        chosen = slots(games, self.num_games)
        rule = "one whole number from 0 to 2**63 - 1 for all arms, or one for each"
        numbers = as_array("seeds", seeds, "iu", rule)
        fits = numbers.ndim == 0 or numbers.shape == chosen.shape
        if not fits or (numbers.size and not 0 <= int(numbers.min()) <= int(numbers.max()) < 2**63):
            raise ValueError(f"seeds={seeds!r}; {rule}")
        each = np.broadcast_to(numbers, chosen.shape).astype(np.uint64)
        rules.seed_arm_starts(self.streams, chosen, each)
        self._coming.fresh[chosen] = True

    # -- copies ----------------------------------------------------------------------------------

    def _live(self) -> dict[str, NDArray[Any]]:
        own = ("streams", "returns", "terminated", "truncated")
        waiting = {f"next_{name}": array for name, array in self._coming._asdict().items()}
        arms = {name: array for name, array in self.arms._asdict().items() if name != "ends"}
        return {**arms, **{name: getattr(self, name) for name in own}, **waiting}

    def get_state(self, games: ArrayLike | None = None) -> SimulatorState:
        """Exact copies of the states of all arms, or of those of the index list `games`."""
        chosen = slots(games, self.num_games)
        state = SimulatorState(**{name: array[chosen] for name, array in self._live().items()})
        if self.auto_restart:  # these arms have already restarted
            state.terminated[:] = state.truncated[:] = False
        return state

    def set_state(self, state: SimulatorState, games: ArrayLike | None = None) -> None:
        """Restore copied states in all arms, or in those of `games`.

        Raises:
            ValueError: a different number of arms or another task, or invalid values. Nothing is
                changed then.
        """
        chosen, live = slots(games, self.num_games), self._live()
        check_fits(state, live, self.task, len(chosen))
        if self.auto_restart and (state.terminated | state.truncated).any():
            raise ValueError("the episode of an arm has ended; reset it, or use auto_restart=False")
        for name, array in live.items():
            array[chosen] = getattr(state, name)
        rules.find_all_ends(self.angles, self.ends)
        self.last_seed = None

    def place(
        self,
        angles: ArrayLike,
        targets: ArrayLike,
        seed: int | None = None,
        games: ArrayLike | None = None,
    ) -> None:
        """Start an episode with these poses and targets.

        Args:
            angles: [num_games, joints] radians, or one row for all.
            targets: [num_games, 2], or one row for all; within reach.
            seed, games: as in `reset`; poses and targets are given for all arms.

        Raises:
            ValueError: a wrong shape, numbers that are not finite, a target out of reach, or a
                locked joint that is not straight. Nothing is changed then.
        """
        poses = _in_one_turn(_rows("angles", angles, (self.num_games, self.task.joints)))
        places = _rows("targets", targets, (self.num_games, 2))
        pending = self._coming  # the settings of the new episode
        free = np.where(pending.free_joints >= 0, pending.free_joints, self.arms.free_joints)
        tolerance = np.where(pending.tolerance >= 0.0, pending.tolerance, self.arms.tolerance)
        self.task.check_targets(places, free, tolerance)
        if poses[np.arange(self.task.joints) >= free[:, None]].any():
            raise ValueError(f"angles={angles!r}; the angles of locked joints must be 0")
        self.reset(seed, games)
        chosen = slots(games, self.num_games)
        self.angles[chosen], self.targets[chosen] = poses[chosen], places[chosen]
        rules.find_all_ends(self.angles, self.ends)

    def __reduce__(self) -> tuple[Any, ...]:
        """For `copy` and `pickle`, which would otherwise separate arrays that share memory."""
        batch = (self.task, self.num_games, self.first_game, self.auto_restart)
        written = (self.rewards, self.episode_returns, self.episode_lengths, *self.final)
        return _copied, (*batch, self.get_state(), tuple(array.copy() for array in written))

    # -- observations ----------------------------------------------------------------------------

    def observe(self, encoding: str = "positions", out: Any = None) -> NDArray[np.float32]:
        """[num_games, numbers] float32, the observations; see `observations.space_of`."""
        return encode(self.task, self.arms, encoding, out)

    def observe_final(
        self, encoding: str = "positions", games: ArrayLike | None = None
    ) -> NDArray[np.float32]:
        """The observations at the end of the last episodes, of all arms or of `games`."""
        chosen = slots(games, self.num_games)
        return encode(self.task, Arms(*(array[chosen] for array in self.final)), encoding)

    def view(self) -> ArmView:
        """The view of the arms for policies."""
        return self._view


def _arms(task: ReacherTask, num_games: int) -> Arms:
    return Arms(
        angles=np.zeros((num_games, task.joints)),
        target=np.zeros((num_games, 2)),
        ends=np.zeros((num_games, task.joints, 2)),
        held=np.zeros(num_games, dtype=np.int32),
        steps=np.zeros(num_games, dtype=np.int32),
        free_joints=np.full(num_games, task.joints, dtype=np.int32),
        hold=np.full(num_games, task.hold, dtype=np.int32),
        tolerance=np.full(num_games, task.tolerance),
    )


def _rows(name: str, value: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    rule = f"finite numbers of shape {shape}, or one row of {shape[1]} for all"
    array = as_array(name, value, "fiu", rule)
    if array.shape not in (shape, shape[1:]) or not np.isfinite(array).all():
        raise ValueError(f"{name}={value!r}; {rule}")
    return np.broadcast_to(array, shape).astype(np.float64)


def _in_one_turn(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same directions in [-pi, pi); angles in this range are unchanged."""
    turned = (angles + np.pi) % (2.0 * np.pi) - np.pi
    turned[turned >= np.pi] = -np.pi  # rounding
    return np.where((angles >= -np.pi) & (angles < np.pi), angles, turned)


def _copied(
    task: ReacherTask,
    num_games: int,
    first_game: int,
    auto_restart: bool,
    state: SimulatorState,
    written: tuple[NDArray[Any], ...],
) -> ReacherSimulator:
    simulator = ReacherSimulator(task, num_games, 0, first_game, auto_restart)
    simulator.set_state(state)
    own = (simulator.rewards, simulator.episode_returns, simulator.episode_lengths)
    for array, copied in zip((*own, *simulator.final), written, strict=True):
        array[:] = copied
    return simulator
