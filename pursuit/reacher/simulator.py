"""The class `ReacherSimulator`, which steps batches of arms."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.memory import check_memory
from pursuit.reacher import rules
from pursuit.reacher.observations import encode
from pursuit.reacher.policy import ArmArrays, ArmView
from pursuit.reacher.rules import Arms, NextEpisode
from pursuit.reacher.state import check_values
from pursuit.reacher.task import LEAST_TOLERANCE, ReacherTask
from pursuit.rules.arrays import Array
from pursuit.rules.randomness import GOLDEN
from pursuit.simulator.batch import Batch
from pursuit.simulator.next_episode import fill, game_indices
from pursuit.simulator.state import SimulatorState
from pursuit.validation import as_array


class ReacherSimulator(ArmArrays, Batch[ReacherTask]):
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
        super().__init__(task, num_games, seed, first_game, auto_restart)
        num_games = self.num_games
        needed = num_games * (2 * 8 * (3 * task.joints + 4) + 128)
        check_memory(f"num_games={num_games}", needed, "take fewer games")
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
        # In the order of `rules.arms_of`.
        rewards = self.rewards, self.returns, self.episode_returns
        ends = self.terminated, self.truncated, self.episode_lengths
        self._arrays = (*self.arms, *rewards, *ends, *self.final, *self._coming, self.streams)
        self._kernel_arrays = (*self._arrays, *task.numbers_for_kernels)
        self._view = ArmView(task, self.arms, self.streams, self.observe)
        self.reset(seed)

    def seed(self, seed: int, games: ArrayLike | None = None) -> None:
        """As `Batch.seed`; the next pose is drawn even if the task keeps poses."""
        super().seed(seed, games)
        self._coming.fresh[game_indices(games, self.num_games)] = True

    def _seed_of_streams(self, seed: int) -> np.uint64:
        return np.uint64((seed + GOLDEN) % 2**64)  # an arm and a maze draw different numbers

    def _start(self, chosen: NDArray[np.bool_]) -> None:
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
        chosen, task = game_indices(games, self.num_games), self.task
        given: dict[str, tuple[ArrayLike | None, float, float]] = {
            "target_distance": (target_distance, -1.0, 1e9),
            "free_joints": (free_joints, 1, task.joints),
            "hold": (hold, 1, task.max_steps),
            "tolerance": (tolerance, LEAST_TOLERANCE, 2.0 * task.joints),
        }
        waiting: dict[str, Array] = {}
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
            waiting[field] = np.empty(len(chosen), dtype=live.dtype)
            fill(name, waiting[field], numbers)
        for name, numbers in waiting.items():
            getattr(self._coming, name)[chosen] = numbers

    def seed_starts(self, games: ArrayLike | None, seeds: ArrayLike) -> None:
        """As `Batch.seed_starts`; the next pose is drawn even if the task keeps poses."""
        super().seed_starts(games, seeds)
        self._coming.fresh[game_indices(games, self.num_games)] = True

    def _live(self) -> dict[str, Array]:
        own = ("streams", "returns", "terminated", "truncated")
        waiting = {f"next_{name}": array for name, array in self._coming._asdict().items()}
        arms = {name: array for name, array in self.arms._asdict().items() if name != "ends"}
        return {**arms, **{name: getattr(self, name) for name in own}, **waiting}

    def _check_values(self, state: SimulatorState) -> None:
        check_values(state, self.task)

    def set_state(self, state: SimulatorState, games: ArrayLike | None = None) -> None:
        """As `Batch.set_state`; the ends of links follow from the angles."""
        super().set_state(state, games)
        rules.find_all_ends(self.angles, self.ends)

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
        chosen = game_indices(games, self.num_games)
        self.angles[chosen], self.targets[chosen] = poses[chosen], places[chosen]
        rules.find_all_ends(self.angles, self.ends)

    # -- observations ----------------------------------------------------------------------------

    def observe(
        self, encoding: str = "positions", out: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """[num_games, numbers] float32, the observations; see `observations.space_of`."""
        return encode(self.task, self.arms, encoding, out)

    def observe_final(
        self, encoding: str = "positions", games: ArrayLike | None = None
    ) -> NDArray[np.float32]:
        """The observations at the end of the last episodes, of all arms or of `games`."""
        chosen = game_indices(games, self.num_games)
        arms = Arms(*(array[chosen] for array in self.final))  # type: ignore[arg-type]
        return encode(self.task, arms, encoding)

    def view(self, seat: int | str = 0) -> ArmView:
        """The view of the arms for policies; `seat` is the only one."""
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
