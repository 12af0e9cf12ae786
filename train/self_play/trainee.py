"""Self-play: all sides of a game learn against each other, measured by exact exploitability."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np

from pursuit.validation import need
from scripted_agents.exact.long_work import report
from train.evaluation.sides import DRY_RUN, Profile, ResultLimits
from train.files import Plain
from train.runs.folder import (
    CONFIG,
    SELF_PLAY,
    SIDE,
    frames_name,
    learned_state,
    load_checkpoint,
    save_checkpoint,
    save_config,
    write_kept,
)
from train.runs.loop import BRIEF_STEPS, build_parts, build_run
from train.runs.trainee import Clock
from train.runs.training_state import policy_memories, restore_policy_memories
from train.self_play.meta_game import Payoffs
from train.self_play.mixtures import snapshot_nash_convs, snapshot_results
from train.self_play.parts import (
    SelfPlayParts,
    response_settings,
    self_play_parts,
    side_settings,
)
from train.self_play.pool import Member, OpponentPool, weights
from train.self_play.side import Side
from train.settings.checks import evaluation_seed
from train.settings.self_play import NASH_SAMPLING
from train.tensors import StateDict


class SelfPlay:
    """All sides learn against each other; a `Trainee`.

    The run folder contains a folder of every side, such as `chaser/` and `evader/`, saved as
    separate policies for `pursuit evaluate`, `render` and `league`, and `pool/` with the snapshots.

    Args:
        parts: of the run.
        folder: of the run.
        state: of `state_dict`; None for a new run.

    Raises:
        One of `MISFITS`: a state of other settings.

    Attributes:
        game: the game of all sides (`train.evaluation.sides.Sides`).
        sides, pools: the learning sides, and the opponents in each role.
        payoffs: between members of the pools.
        mixtures: the Nash mixtures that the rules of `NASH_SAMPLING` draw from.
        taken, progress: snapshots and progress so far, in [0, 1].
        limits: of the results.
        last: the last evaluation.
        on_snapshot: called with this object after every snapshot.
    """

    kind: ClassVar[str] = SELF_PLAY
    evaluates_first: ClassVar[bool] = True

    def __init__(self, parts: SelfPlayParts, folder: Path, state: StateDict | None = None) -> None:
        self.settings, self.game = parts.settings, parts.game
        self.parts, self.folder = parts, folder
        self.sides: dict[str, Side] = {}
        for role, own in parts.sides.items():
            others = [other for other in parts.game.roles if other != role]
            saved = None if state is None else state["sides"][role]
            self.sides[role] = Side(own, parts.game.roles.index(role), others, saved)
        self.pools = {role: self._pool(role) for role in parts.game.roles}
        for side in self.sides.values():
            for other, policy in side.opponents.policies.items():
                policy.pool = self.pools[other]
        self.on_snapshot: Callable[[SelfPlay], object] = lambda trainee: None
        self.rng = np.random.default_rng(parts.settings.seed)
        self.taken, self.progress, self.last = 0, 0.0, dict[str, float]()
        self.limits = ResultLimits()
        self.payoffs = Payoffs(self.pools, tuple(self.sides), self.payoff)
        self.mixtures: dict[str, dict[str, float]] = {}
        if state is not None:
            self._load_state_dict(state)
        self._update_sampling()
        self.objective = self.game.objective(self.policies)

    @property
    def policies(self) -> dict[str, Any]:
        """The policies that are evaluated, by role."""
        return {role: self.policy(role) for role in self.game.roles}

    @property
    def profile(self) -> Profile:
        """The policies that are evaluated, and those to compare with."""
        return Profile(self.policies, tuple(self.sides), self.parts.scripted)

    def payoff(self, one: Any, two: Any) -> float:
        """The payoff of two policies, which the second role maximises."""
        return self.game.payoff(one, two, evaluation_seed(self.settings.seed))

    def _pool(self, role: str) -> OpponentPool:
        if role in self.sides:
            latest, load = self.sides[role].policy(), self.sides[role].load
        else:
            latest, load = self.parts.frozen[role], lambda state: latest
        sampling = self.settings.sampling
        # A run with a longer budget has more snapshots.
        size = sys.maxsize if sampling in NASH_SAMPLING else self.settings.pool_size
        newest = sampling == "window"
        pool = OpponentPool(self.folder / "pool" / role, latest, size, load, newest)
        for name in self.settings.members:
            if (name, role) in self.parts.scripted:
                pool.add_scripted(name, self.parts.scripted[name, role])
        return pool

    @property
    def frames(self) -> int:
        """Steps of all learning agents."""
        return sum(side.learner.frames for side in self.sides.values())

    def policy(self, role: str) -> Any:
        """The policy of a role that is evaluated: with averaged weights (or the last ones, by the
        settings), in float32 and without improbable actions."""
        if role not in self.sides:
            return self.parts.frozen[role]
        return self.sides[role].evaluated(self.sides[role].snapshot())

    def iterate(self, clock: Clock) -> dict[str, float]:
        """One iteration of every learner; adds snapshots when they are due."""
        figures: dict[str, float] = {}
        progress = clock.scheduled
        if self.settings.sampling == "psro":  # every best response has its own schedules
            progress = progress * self.settings.snapshots - self.taken
        for role, side in self.sides.items():
            logged = side.iterate(min(max(progress, 0.0), 1.0))
            figures |= {f"{role}_{name}": value for name, value in logged.items()}
        due = int(clock.scheduled * self.settings.snapshots)
        if due > self.taken:
            self.taken = due
            self._take_snapshots()
            self.on_snapshot(self)
            if self.settings.sampling == "psro" and clock.progress < 1.0:
                for side in self.sides.values():
                    side.restart()
        self.taken = min(self.taken, due)  # schedules may have been extended
        self.progress = min(clock.scheduled, 1.0)
        self._update_sampling()
        return figures

    # -- opponents -------------------------------------------------------------------------------

    def _update_sampling(self) -> None:
        """Update the sampling probabilities of opponents."""
        settings = self.settings
        for side in self.sides.values():
            for role in side.opponents.shares:
                pool, mixture = self.pools[role], None
                if settings.sampling in NASH_SAMPLING and self.mixtures:
                    by_name = self.mixtures[role]
                    shares = np.array([by_name.get(name, 0.0) for name in pool.names])
                    mixture = shares / shares.sum() if shares.sum() > 0 else None
                sampling = settings.sampling if role in self.sides else "latest"
                how = (sampling, settings.window, settings.pfsp_power, mixture, self.payoffs)
                side.opponents.shares[role] = weights(pool, *how, self.progress)

    def _take_snapshots(self) -> None:
        places = {role: pool.names for role, pool in self.pools.items()}
        for role, side in self.sides.items():
            self.pools[role].add(frames_name(self.frames), side.snapshot(), self.rng)
        for role, names in places.items():
            self._keep_opponents(role, names)
        self.payoffs.forget()
        if self.settings.sampling in NASH_SAMPLING:
            self.mixtures = self.payoffs.mixtures()

    def _keep_opponents(self, role: str, before: list[str]) -> None:
        """Update the opponents of running games after members of a pool have moved."""
        names = self.pools[role].names
        moved = np.array([names.index(name) if name in names else 0 for name in before])
        for side in self.sides.values():
            if role in side.opponents.policies:
                opponents = side.opponents.policies[role].opponents
                opponents[:] = moved[opponents]

    # -- evaluation ------------------------------------------------------------------------------

    def evaluate(self, episodes: int = 300, most: int = 0) -> dict[str, float]:
        """As `Sides.evaluate`."""
        self.last = self.game.evaluate(self.profile, episodes, most)
        return self.last

    def forget_episodes(self) -> None:
        """As `Trainee`; self-play logs no means over training games."""
        for side in self.sides.values():
            side.env.finished_returns.clear()
            side.env.finished_lengths.clear()

    def log_fields(self, row: dict[str, float]) -> list[str]:
        """As `Sides.fields`."""
        return self.game.fields(row)

    def results(self, episodes: int) -> Plain:
        """The evaluation, the policies against others, the pools, and further results of the game
        (`Sides.more`)."""
        limits, profile = self.limits, self.profile
        evaluation = dict(self.last) if limits.is_dry_run else {}
        evaluation = evaluation or self.evaluate(episodes, limits.evaluated_work)
        sides = [*self.sides.values()]
        updates = (getattr(side.learner, "update_form", "torch") for side in sides)
        content: Plain = {
            **self.game.describe_game(),
            "algorithm": ", ".join(side.parts.algorithm.name for side in sides),
            "sampling": self.settings.sampling,
            "seed": self.settings.seed,
            "discount": self.game.discount,
            "precision": sides[0].parts.build.precision,
            "update": ", ".join(updates),
            "evaluation": evaluation,
            **self.game.played(profile, episodes, limits),
            "pools": {role: pool.described() for role, pool in self.pools.items()},
            "mixtures": self.mixtures,
        }

        def add_snapshots() -> None:
            self.add_snapshot_results(content, profile.policies)

        respond = self.response_to if self.settings.best_response_seconds else None
        self.game.more(content, profile, episodes, limits, add_snapshots, respond)
        return content

    def response_to(self, role: str) -> dict[str, Any]:
        """The policies of all sides after PPO has learned against that of this role, which is
        fixed: a bound on the value of a best response."""
        settings = response_settings(self.settings, role, self.folder / role)
        with TemporaryDirectory() as folder:
            run = build_run(SelfPlay, build_parts(self_play_parts, settings), Path(folder))
            what = f"approximate best response against the {role}"
            if not self.limits.is_dry_run:
                run.train(lambda run, row: report(what, run.progress))
            policies: dict[str, Any] = run.trainee.policies
            return policies

    def add_snapshot_results(self, content: Plain, policies: Mapping[str, Any]) -> None:
        """Add `snapshot_results`, and in the evaluation NashConv of the policies that the sampling
        rule converges in: of the mixture (the lower bound), or of the last ones, `policies`."""
        kept = {role: self.pools[role].snapshots for role in self.sides}
        mixtures: Mapping[str, Mapping[str, float]] | None = self.mixtures
        if self.limits.is_dry_run:
            kept = {r: [Member(name, policies[r], False) for name in "ab"] for r in self.sides}
            mixtures = None
        least = next(iter(self.sides.values())).parts.min_probability
        content |= snapshot_results(self.game, self.settings.sampling, kept, mixtures, least)
        bounds, evaluation = content.get("mixture_nash_conv"), content["evaluation"]
        evaluation["played_nash_conv"] = bounds[0] if bounds else evaluation["nash_conv"]
        if not self.game.compares_weights:
            return
        fixed = {role: policy for role, policy in policies.items() if role not in self.sides}
        content["nash_conv_of"] = snapshot_nash_convs(
            self.sides, lambda learned: need(self.game.nash_conv({**fixed, **learned}))
        )

    def brief(self) -> SelfPlay:
        """As `Trainee`."""
        small = copy(self)
        small.game, small.limits = self.game.brief(BRIEF_STEPS), DRY_RUN
        return small

    # -- files -----------------------------------------------------------------------------------

    def state_dict(self) -> StateDict:
        """Both sides, the members of the pools, and the meta-game."""
        return {
            "sides": {role: side.state_dict() for role, side in self.sides.items()},
            "pools": {role: pool.state_dict() for role, pool in self.pools.items()},
            "memories": {role: policy_memories(side.env) for role, side in self.sides.items()},
            "rng": self.rng.bit_generator.state,
            "taken": self.taken,
            "progress": self.progress,
            "payoffs": [[*pair, value] for pair, value in self.payoffs.known.items()],
            "mixtures": self.mixtures,
        }

    def learned(self) -> StateDict:
        """The states of the learners."""
        return {role: side.learner.state_dict() for role, side in self.sides.items()}

    def _load_state_dict(self, state: StateDict) -> None:
        for role, side in self.sides.items():
            side.learner.load_state_dict(state["sides"][role]["learner"])
        for role, pool in self.pools.items():
            before = [entry["name"] for entry in state["pools"][role]["members"]]
            pool.load_state_dict(state["pools"][role])
            self._keep_opponents(role, before)
        for role, side in self.sides.items():  # after their opponents are restored
            restore_policy_memories(side.env, state["memories"][role])
        self.rng.bit_generator.state = state["rng"]
        self.taken, self.progress = state["taken"], state["progress"]
        self.mixtures = state["mixtures"]
        self.payoffs.known = {(one, two): value for one, two, value in state["payoffs"]}

    def keep(self, folder: Path, name: str) -> None:
        """As `Trainee`: every side that learns."""
        for role, side in self.sides.items():
            own, learner = side.parts, side.learner.state_dict() | side.snapshot()
            write_kept(folder / role, name, own.algorithm, own.seat, learner)

    def evaluate_kept(self, folder: Path, frames: int, episodes: int) -> Plain:
        """As `Trainee`: the columns of an evaluation."""
        policies = self.policies
        for role, side in self.sides.items():
            state = load_checkpoint(folder / role, frames)["trainee"]["learner"]
            policies[role] = side.evaluated(state)
        profile = replace(self.profile, policies=policies, seed=evaluation_seed(1))
        return {**self.game.evaluate(profile, episodes, self.limits.evaluated_work)}

    def save_beside(self, folder: Path) -> None:
        """Write every role as a separate policy, and delete snapshots that are in no pool."""
        for role, side in self.sides.items():
            own = folder / role
            if not (own / CONFIG).exists():
                own.mkdir(exist_ok=True)
                maze = self.settings.task.maze_text
                save_config(own, SIDE, side_settings(self.settings, role), maze)
            learner = side.learner.state_dict() | side.snapshot()
            state = learned_state(side.parts.algorithm.name, side.parts.seat, learner)
            save_checkpoint(own, {"trainee": state})
        for pool in self.pools.values():
            pool.clean()

    def close(self) -> None:
        """Close the learners."""
        for side in self.sides.values():
            side.learner.close()
