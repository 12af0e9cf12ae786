"""Self-play: chasers and evaders learn against each other, measured by exact exploitability."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.policy import Policy
from pursuit.simulator import Simulator, SimulatorState
from pursuit.task import Task
from scripted_agents import mean_over_starts
from scripted_agents.environments import SCRIPTED, scripted_policy
from train.algorithms.learner import Learner
from train.algorithms.registry import Build, entry
from train.environments.hooks import EpisodeHook
from train.environments.team_env import TeamEnv
from train.evaluation.exploitability import exploitability, nash_conv
from train.evaluation.matchups import is_exact, match, table_in
from train.networks.policy import Seat
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    FORMAT,
    RESULTS,
    MetricsFile,
    load_checkpoint,
    load_settings,
    save_checkpoint,
    save_settings,
    write_json,
)
from train.runs.interruption import Interruption
from train.runs.run import MISFITS, has_fast_bfloat16, keep_freed_memory, load_policy
from train.self_play.pool import (
    LATEST,
    OpponentPool,
    PoolPolicy,
    draw_opponents,
    nash_mixtures,
    weights,
)
from train.settings.checks import check
from train.settings.self_play import (
    LEARN,
    ROLES,
    SETTINGS,
    SelfPlaySettings,
    load_self_play_settings,
)

EVALUATIONS = 20
MAX_GAME_CELLS = 256
"""Above this number of cells the value of the game is not solved in every run (minutes)."""
PAIR_EPISODES = 200
"""Games for an entry of the payoff matrix that has no exact value."""

Report = Callable[["SelfPlay", dict[str, float]], None]


class OpponentDraws(EpisodeHook):
    """Draws an opponent for every episode, and notes how the learner fares against it.

    Args:
        simulator: the games.
        role: the learner's.
        opponent: fills all other seats.
        discount: of the scores that the pool keeps.
        seed: of the draws.

    Attributes:
        shares: how often each member of the pool is drawn.
        rng: what draws them.
    """

    def __init__(
        self, simulator: Simulator, role: str, opponent: PoolPolicy, discount: float, seed: int
    ) -> None:
        self.simulator, self.role, self.opponent = simulator, role, opponent
        self.discount, self.rng = discount, np.random.default_rng(seed)
        self.shares: NDArray[np.float64] = np.ones(1)

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Draw their opponents."""
        self.opponent.opponents[games] = draw_opponents(self.shares, len(games), self.rng)

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Note the learner's scores against their opponents.

        An evader's score is 1 - discount ** steps: what it got of the most that it could get, in
        the discounted game; a chaser's is discount ** steps.
        """
        left = self.discount ** self.simulator.steps[games].astype(np.float64)
        scores = left if self.role == "chaser" else 1.0 - left
        opponents = self.opponent.opponents[games]
        for member in np.unique(opponents).tolist():
            self.opponent.pool.note(member, scores[opponents == member])


class Side:
    """One role that learns: its games, its learner, and the opponents it meets.

    Attributes:
        env, learner: of this role.
        opponent: fills the other role's seats.
    """

    def __init__(
        self, settings: SelfPlaySettings, role: str, state: dict[str, Any] | None = None
    ) -> None:
        own = settings.of_role(role)
        self.role, self.settings = role, own
        player = Seat(own.task.build(), role, own.observation)
        self.player, self.algorithm = player, entry(own.algorithm)
        number = ROLES.index(role)
        games = own.hyper.num_games // player.members
        # Both roles' games begin differently though they share a seed.
        self.simulator = Simulator(
            player.task, games, settings.seed, first_game=number * 2**20, auto_restart=False
        )
        empty: Any = None
        self.opponent = PoolPolicy(empty, games)
        self.draws = OpponentDraws(
            self.simulator, role, self.opponent, settings.hyper.gamma, 2 * settings.seed + number
        )
        self.env = TeamEnv(
            self.simulator,
            player,
            [None if r == role else self.opponent for r in player.task.seat_roles],
            self.draws,
            central=own.hyper.central_critic,
            # Discounted steps, up to 1 / (1 - gamma) of them, would drown the policy in value loss.
            scale=1.0 - settings.hyper.gamma if own.task.rewards == "zero_sum" else 1.0,
        )
        if state is not None:  # before there is a collector, which begins with what it finds
            self._restore_games(state)
        how = Build(own.device, has_fast_bfloat16(), own.first_layer, own.seed)
        self.learner: Learner = self.algorithm.build(own.hyper, self.env, how)

    def policy(self) -> Policy:
        """As it plays while it learns: drawn, where there is a distribution."""
        return self.learner.policy(greedy=not self.algorithm.learns_distribution)

    def load(self, state: dict[str, Any]) -> Policy:
        """The policy of a snapshot."""
        greedy = not self.algorithm.learns_distribution
        return self.algorithm.load(self.settings.hyper, self.player, state, greedy)

    def snapshot(self) -> dict[str, Any]:
        """What `load` needs."""
        network: Any = self.learner.state_dict()["network"]
        return {"network": {name: tensor.clone() for name, tensor in network.items()}}

    def state_dict(self) -> dict[str, Any]:
        """Everything but the pool."""
        games = vars(self.simulator.get_state())
        return {
            "learner": self.learner.state_dict(),
            "simulator": {
                name: torch.from_numpy(array.view(np.int64) if name == "streams" else array)
                for name, array in games.items()
            },
            "opponents": torch.from_numpy(self.opponent.opponents.copy()),
            "idle": torch.from_numpy(self.env.idle.copy()),
            "rng": self.draws.rng.bit_generator.state,
        }

    def _restore_games(self, state: dict[str, Any]) -> None:
        arrays = {name: tensor.numpy() for name, tensor in state["simulator"].items()}
        arrays["streams"] = arrays["streams"].view(np.uint64)
        self.simulator.set_state(SimulatorState(**arrays))
        self.opponent.opponents[:] = state["opponents"].numpy()
        self.env.idle[:] = state["idle"].numpy()
        self.draws.rng.bit_generator.state = state["rng"]
        self.env.resume = True


class SelfPlay:
    """Both roles learning against each other, in a folder.

    `chaser/` and `evader/` in it are runs of their own for `pursuit evaluate`, `render` and
    `league`; `pool/` holds the snapshots.

    Args:
        settings: what to do.
        folder: an empty one, or that of the run to go on with.
        resume: go on from its checkpoint.

    Raises:
        ValueError: settings that cannot run here, or a checkpoint that does not fit.
    """

    def __init__(self, settings: SelfPlaySettings, folder: Path, resume: bool = False) -> None:
        self.settings, self.folder, self.stopped = settings, folder, False
        keep_freed_memory()
        torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        self.task: Task = settings.task.build()
        state = load_checkpoint(folder) if resume else None
        try:
            given = {role: state["sides"][role] if state else None for role in settings.learning}
            self.sides = {role: Side(settings, role, given[role]) for role in settings.learning}
        except MISFITS:
            raise self._misfit() from None
        if settings.share_networks:
            _share(self.sides)
        self.pools = {role: self._pool(role) for role in ROLES}
        for role, side in self.sides.items():
            side.opponent.pool = self.pools[_other(role)]
        self.rng = np.random.default_rng(settings.seed)
        self.seconds, self.evaluations, self.taken = 0.0, 0, 0
        self.payoffs: dict[tuple[str, str], float] = {}
        self.mixtures: dict[str, dict[str, float]] = {}
        if state is not None:
            self._resume(state)
        self.metrics = MetricsFile(folder, self.frames if resume else None)
        self._share_out()

    def _pool(self, role: str) -> OpponentPool:
        settings, frozen = self.settings, getattr(self.settings, role)
        if role in self.sides:
            side = self.sides[role]
            latest, load = side.policy(), side.load
        else:
            latest, load = frozen_policy(frozen, role, settings), lambda state: latest
        pool = OpponentPool(self.folder / "pool" / role, latest, settings.pool_size, load)
        for name in settings.members:
            pool.add_scripted(name, scripted_opponent(name, role, settings))
        return pool

    @property
    def frames(self) -> int:
        """Steps of all learning agents."""
        return sum(side.learner.frames for side in self.sides.values())

    @property
    def progress(self) -> float:
        """Share of the budget spent, in [0, 1]."""
        if self.settings.frames is not None:
            return min(self.frames / self.settings.frames, 1.0)
        return min(self.seconds / (self.settings.seconds or 1.0), 1.0)

    def train(self, report: Report = lambda run, row: None) -> None:
        """Learn until the budget is spent; Ctrl-C (or SIGTERM) ends it after the current rollouts.

        Args:
            report: called with every row of `metrics.csv`, and with {} after every iteration.
        """
        with Interruption() as interruption:
            if not self.metrics.rows:
                self._record({}, report)
            while self.progress < 1.0 and not self.stopped:
                began = perf_counter()
                losses: dict[str, float] = {}
                for role, side in self.sides.items():
                    found = side.learner.iterate(self.progress)
                    losses |= {f"{role}_{name}": value for name, value in found.items()}
                if self.progress * self.settings.snapshots >= self.taken + 1:
                    self._take_snapshots()
                self._share_out()
                self.seconds += perf_counter() - began
                self.stopped = interruption.asked
                report(self, {})
                if self.progress * EVALUATIONS >= self.evaluations + 1 or self.stopped:
                    self.evaluations = int(self.progress * EVALUATIONS)
                    self._record(losses, report)
        for side in self.sides.values():
            side.learner.close()

    # -- opponents -------------------------------------------------------------------------------

    def _share_out(self) -> None:
        """How often each opponent is drawn from now on."""
        settings = self.settings
        for role, side in self.sides.items():
            pool = self.pools[_other(role)]
            mixture = None
            if settings.sampling == "psro" and self.mixtures:
                given = self.mixtures[_other(role)]
                shares = np.array([given.get(name, 0.0) for name in pool.names])
                mixture = shares / shares.sum() if shares.sum() > 0 else None
            sampling = settings.sampling if _other(role) in self.sides else "latest"
            arguments = (settings.window, settings.pfsp_power, mixture)
            side.draws.shares = weights(pool, sampling, *arguments)

    def _take_snapshots(self) -> None:
        self.taken = int(self.progress * self.settings.snapshots)
        places: dict[str, list[str]] = {role: self.pools[role].names for role in ROLES}
        for role, side in self.sides.items():
            self.pools[role].add(f"{self.taken:05d}", side.snapshot(), self.rng)
        for role, side in self.sides.items():
            # Members may have moved: games go on against whom they began.
            pool = self.pools[_other(role)]
            moved = np.array(
                [pool.names.index(n) if n in pool.names else 0 for n in places[_other(role)]]
            )
            side.opponent.opponents[:] = moved[side.opponent.opponents]
        if self.settings.sampling == "psro":
            self._solve_meta_game()

    def _solve_meta_game(self) -> None:
        """The Nash mixture of all pairs of snapshots (and scripted members; not the latest)."""
        members = {
            role: [
                m for m in self.pools[role].members if m.name != LATEST or role not in self.sides
            ]
            for role in ROLES
        }
        payoff = np.empty([len(members[role]) for role in ROLES])
        for i, chaser in enumerate(members["chaser"]):
            for j, evader in enumerate(members["evader"]):
                pair = (chaser.name, evader.name)
                if pair not in self.payoffs:
                    self.payoffs[pair] = self._payoff(chaser.policy, evader.policy)
                payoff[i, j] = self.payoffs[pair]
        for role, mixture in zip(ROLES, nash_mixtures(payoff), strict=True):
            names = [member.name for member in members[role]]
            self.mixtures[role] = dict(zip(names, mixture.tolist(), strict=True))

    def _payoff(self, chaser: Policy, evader: Policy) -> float:
        """Mean steps until capture: exact in a duel."""
        return match(self.task, chaser, evader, PAIR_EPISODES, self.settings.seed).steps

    # -- evaluation and files --------------------------------------------------------------------

    def policy(self, role: str) -> Policy:
        """Who plays a role now."""
        return self.pools[role].members[0].policy

    def evaluate(self, episodes: int = 300) -> dict[str, float]:
        """Exact exploitability where it can be had, and both sides against scripted agents.

        Exploitability is in discounted steps, lengths are in steps.
        """
        task, row = self.task, {}
        chaser, evader = self.policy("chaser"), self.policy("evader")
        if is_exact(task, chaser, evader):
            maze = task.mazes[0]
            tables = [table_in(task, policy) for policy in (chaser, evader)]
            rest: Any = (self.settings.hyper.gamma, task.move_order)
            if maze.num_cells <= MAX_GAME_CELLS:
                found = exploitability(maze, tables[0], tables[1], *rest)
                row = {
                    "nash_conv": found.nash_conv,
                    "chaser_exploitability": found.mean_chaser,
                    "evader_exploitability": found.mean_evader,
                    "value": mean_over_starts(found.values, maze),
                    "game_value": mean_over_starts(found.game_values, maze),
                }
            else:
                row = {"nash_conv": nash_conv(maze, tables[0], tables[1], *rest)}
        row["steps"] = match(task, chaser, evader, episodes).steps
        for name in self._scripted():
            for role in self.sides:
                other = scripted_opponent(name, _other(role), self.settings)
                one, two = (chaser, other) if role == "chaser" else (other, evader)
                row[f"{role}_vs_{name}"] = match(task, one, two, episodes).steps
        return row

    def _scripted(self) -> tuple[str, ...]:
        """The scripted agents that stand beside the learned ones: optimal only where it is so."""
        solved = self.task.is_duel and self.task.max_cells <= MAX_GAME_CELLS
        return tuple(name for name in SCRIPTED if name != "optimal" or solved)

    def matches(self, episodes: int) -> list[dict[str, Any]]:
        """Learned and scripted agents of both roles, everybody against everybody."""
        players = {
            role: {"learned" if role in self.sides else "frozen": self.policy(role)}
            | {name: scripted_opponent(name, role, self.settings) for name in self._scripted()}
            for role in ROLES
        }
        return [
            {"chaser": c, "evader": e, **asdict(match(self.task, chaser, evader, episodes))}
            for c, chaser in players["chaser"].items()
            for e, evader in players["evader"].items()
        ]

    def _record(self, losses: dict[str, float], report: Report) -> None:
        row = {
            "frames": float(self.frames),
            "seconds": self.seconds,
            "frames_per_second": self.frames / max(self.seconds, 1e-9),
            **self.evaluate(),
        }
        for side in self.sides.values():
            side.env.finished_returns.clear()
            side.env.finished_lengths.clear()
        row = {**row, **losses}
        self.metrics.add(row)
        self.save()
        report(self, row)

    def save(self) -> None:
        """Write the checkpoint, and every role as a run of its own."""
        save_checkpoint(
            self.folder,
            {
                "sides": {role: side.state_dict() for role, side in self.sides.items()},
                "pools": {role: pool.state_dict() for role, pool in self.pools.items()},
                "rng": self.rng.bit_generator.state,
                "torch_rng": torch.get_rng_state(),
                "seconds": self.seconds,
                "evaluations": self.evaluations,
                "taken": self.taken,
                "payoffs": [[*pair, value] for pair, value in self.payoffs.items()],
                "mixtures": self.mixtures,
            },
        )
        for role, side in self.sides.items():
            folder = self.folder / role
            if not (folder / CONFIG).exists():
                folder.mkdir(exist_ok=True)
                save_settings(folder, side.settings)
            save_checkpoint(folder, {"learner": side.learner.state_dict()})
        for pool in self.pools.values():
            pool.clean()

    def _resume(self, state: dict[str, Any]) -> None:
        try:
            for role, side in self.sides.items():
                side.learner.load_state_dict(state["sides"][role]["learner"])
            for role, pool in self.pools.items():
                before = [entry["name"] for entry in state["pools"][role]]
                pool.load_state_dict(state["pools"][role])
                moved = [pool.names.index(n) if n in pool.names else 0 for n in before]
                if _other(role) in self.sides:
                    opponents = self.sides[_other(role)].opponent.opponents
                    opponents[:] = np.array(moved)[opponents]
            self.rng.bit_generator.state = state["rng"]
            torch.set_rng_state(state["torch_rng"])
            self.seconds, self.evaluations = state["seconds"], state["evaluations"]
            self.taken, self.mixtures = state["taken"], state["mixtures"]
            self.payoffs = {(chaser, evader): value for chaser, evader, value in state["payoffs"]}
        except MISFITS:
            raise self._misfit() from None

    def _misfit(self) -> ValueError:
        return ValueError(
            f"{self.folder}: the checkpoint does not fit the settings in {SETTINGS}; one of the "
            "two is from another run"
        )

    def results(self, episodes: int = 1000) -> dict[str, Any]:
        """Evaluate once more, on more episodes, and write `results.json`."""
        rows = self.metrics.rows
        content: dict[str, Any] = {
            "task": self.settings.task.task,
            "maze": self.task.mazes[0].name,
            "sampling": self.settings.sampling,
            "seed": self.settings.seed,
            "frames": self.frames,
            "seconds": round(self.seconds, 3),
            "frames_per_second": round(self.frames / max(self.seconds, 1e-9), 1),
            "interrupted": self.stopped,
            "evaluation": self.evaluate(episodes),
            "matches": self.matches(episodes),
            "pools": {role: pool.state_dict() for role, pool in self.pools.items()},
            "mixtures": self.mixtures,
        }
        if "nash_conv" in rows[0]:
            start, end = rows[0]["nash_conv"], content["evaluation"]["nash_conv"]
            content["nash_conv_at_start"], content["nash_conv_reduction"] = start, 1 - end / start
        elif self.settings.best_response_seconds and not self.stopped:
            content["approximate_best_response"] = self.approximate_best_responses(episodes)
        write_json(self.folder / RESULTS, content)
        return content

    def approximate_best_responses(self, episodes: int) -> dict[str, float]:
        """Mean steps after a PPO was trained against each learned side, which stood still.

        A bound on what a best response gets, not its value: {"against_evader": steps, ...}.
        """
        found = {}
        for role in self.sides:
            other = _other(role)
            seconds = self.settings.best_response_seconds
            who: Any = {role: str(self.folder / role), other: LEARN, f"{other}_algorithm": "ppo"}
            settings = replace(
                self.settings,
                **who,
                share_networks=False,
                sampling="latest",
                members=(),
                seconds=seconds,
                frames=None,
                best_response_seconds=0.0,
            )
            with TemporaryDirectory() as folder:
                run = SelfPlay(settings, Path(folder))
                run.train()
                pair = (run.policy("chaser"), run.policy("evader"))
                found[f"against_{role}"] = match(self.task, *pair, episodes).steps
        return found


def scripted_opponent(name: str, role: str, settings: SelfPlaySettings) -> Policy:
    """A scripted agent by its name; A* moves at random as often as `opponent_epsilon` says."""
    task = settings.task
    epsilon = task.opponent_epsilon if name == "astar" else 0.0
    rest: Any = (epsilon, task.move_order, settings.hyper.gamma)
    return scripted_policy(name, role, *rest)


def frozen_policy(name: str, role: str, settings: SelfPlaySettings) -> Policy:
    """Who plays a role that does not learn: a scripted agent, or the folder of a run.

    Raises:
        ValueError: neither; or the run learned another role, or in other games.
    """
    if name in SCRIPTED:
        return scripted_opponent(name, role, settings)
    from train.runs.third_party import load_opponent

    folder = Path(name)
    if (folder / CONFIG).exists():
        policy = load_policy(
            folder, greedy=not entry(load_settings(folder).algorithm).learns_distribution
        )
    else:
        policy = load_opponent(folder)
    check_fits(policy, role, settings.task.build(), name)
    return policy


def check_fits(policy: Policy, role: str, task: Task, name: str) -> None:
    """Raise ValueError unless a learned policy is of this role and of games like these."""
    if not hasattr(policy, "task"):
        return
    learner: Any = policy
    own: Task = learner.task
    learned = own.seat_roles[own.seat(learner.agent)]
    check(learned == role, f"{name}: learned to be {learned!r}; {role!r} is asked for")
    check(
        set(task.mazes) <= set(own.mazes),
        f"{name}: learned in maze {own.mazes[0].name}, and the games are in {task.mazes[0].name}",
    )
    for what in ("num_chasers", "num_evaders", "num_goals", "stay_action", "move_order"):
        mine, theirs = getattr(own, what), getattr(task, what)
        check(mine == theirs, f"{name}: learned with {what}={mine}; the games have {theirs}")


def start_self_play(settings: SelfPlaySettings, folder: Path) -> SelfPlay:
    """New self-play in a new folder; the settings are on disk before anything is learned."""
    run = SelfPlay(settings, folder)
    text = run.task.mazes[0].to_text()
    write_json(folder / SETTINGS, {"format": FORMAT, **asdict(settings), "maze_text": text})
    return run


def resume_self_play(folder: Path) -> SelfPlay:
    """Go on with the self-play in `folder`; ValueError where there is none, or it is complete.

    One that was killed before its first checkpoint begins anew; one that was killed after its last
    has only its results to write.
    """
    begun = (folder / CHECKPOINT).exists()
    run = SelfPlay(load_self_play_settings(folder), folder, resume=begun)
    if run.progress >= 1.0 and (folder / RESULTS).exists():
        raise ValueError(f"{folder}: complete; its budget is spent. See {folder / RESULTS}")
    return run


def _other(role: str) -> str:
    return ROLES[1 - ROLES.index(role)]


def _share(sides: dict[str, Side]) -> None:
    """Give both roles one trunk, and every learner an optimizer of what it now has."""
    one, two = (sides[role].learner for role in ROLES)
    network: Any = two.network  # type: ignore[attr-defined]
    trunk = one.network.policy_trunk  # type: ignore[attr-defined]
    if network.shared:
        network.value_trunk = trunk
    network.policy_trunk = trunk
    two.renew_optimizer()  # type: ignore[attr-defined]
