"""Self-play: chasers and evaders learn against each other, measured by exact exploitability."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pursuit.simulator.policy import Policy
from scripted_agents.games.simulator import GameTask
from scripted_agents.limits import MAX_FINAL_WORK, MAX_SNAPSHOT_CELLS
from scripted_agents.long_work import report
from scripted_agents.references import is_exact_team
from train.evaluation.games import other_role
from train.evaluation.matchups import discounted_steps, match
from train.evaluation.scores import DISCOUNTED, OUTCOME, Measure
from train.files import Plain
from train.runs.folder import CONFIG, SELF_PLAY, SIDE, game_digest, save_checkpoint, save_config
from train.runs.loop import BRIEF_STEPS
from train.runs.trainee import Clock
from train.runs.training_state import policy_memories, restore_policy_memories
from train.self_play.meta_game import PAIR_EPISODES, Payoffs
from train.self_play.metrics import (
    DRY_RUN,
    ResultLimits,
    approximate_best_responses,
    exact_best_responses,
    exploited,
    format_row,
    has_nash_conv,
    limited_best_responses,
    matches,
    scripted_references,
    team_references,
    whole_game,
)
from train.self_play.mixtures import nash_convs_of, snapshot_results
from train.self_play.parts import SelfPlayParts, side_settings
from train.self_play.pool import Member, OpponentPool, weights
from train.self_play.side import Side
from train.settings.checks import evaluation_seed
from train.settings.self_play import NASH_SAMPLING, ROLES
from train.tensors import State


class SelfPlay:
    """Both roles learn against each other; a `Trainee`.

    The run folder contains `chaser/` and `evader/`, saved as separate policies for
    `pursuit evaluate`, `render` and `league`, and `pool/` with the snapshots.

    Args:
        parts: of the run.
        folder: of the run.
        state: of `state_dict`; None for a new run.

    Raises:
        One of `MISFITS`: a state of other settings.

    Attributes:
        task, sides, pools: the game, the learning sides, and the opponents in each role.
        payoffs: between members of the pools.
        mixtures: the Nash mixtures that the rules of `NASH_SAMPLING` draw from.
        taken, progress: snapshots and progress so far, in [0, 1].
        limits: of the results.
        last: the last evaluation.
        on_snapshot: called with this object after every snapshot.
    """

    kind: ClassVar[str] = SELF_PLAY
    evaluates_first: ClassVar[bool] = True

    def __init__(self, parts: SelfPlayParts, folder: Path, state: State | None = None) -> None:
        self.settings, self.task = parts.settings, parts.task
        self.parts, self.folder = parts, folder
        self.sides: dict[str, Side] = {}
        for role, own in parts.sides.items():
            others = [other for other in parts.roles if other != role]
            saved = None if state is None else state["sides"][role]
            self.sides[role] = Side(own, parts.roles.index(role), others, saved)
        self.pools = {role: self._pool(role) for role in parts.roles}
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
        self.objective = self._objective()

    def _objective(self) -> Measure:
        # It depends on the game alone: every learned policy is a table.
        exact = has_nash_conv(self.task, self.policy("chaser"), self.policy("evader"))
        unit = OUTCOME if self.task.most_exits else DISCOUNTED
        column, unit = ("nash_conv", unit) if exact else ("steps", "steps")
        return Measure(column, unit)

    def payoff(self, chaser: Policy, evader: Policy) -> float:
        """The payoff of two policies, which evaders maximise: `discounted_steps`."""
        seed = evaluation_seed(self.settings.seed)
        return discounted_steps(self.task, chaser, evader, self.parts.discount, PAIR_EPISODES, seed)

    def _pool(self, role: str) -> OpponentPool:
        if role in self.sides:
            latest, load = self.sides[role].policy(), self.sides[role].load
        else:
            latest, load = self.parts.frozen[role], lambda state: latest
        size, newest = self.settings.pool_size, self.settings.sampling == "window"
        pool = OpponentPool(self.folder / "pool" / role, latest, size, load, newest)
        for name in self.settings.members:
            if (name, role) in self.parts.scripted:
                pool.add_scripted(name, self.parts.scripted[name, role])
        return pool

    def line(self) -> str:
        """The game in one line of text."""
        task = self.task
        return (
            f"{task.name} on maze {task.mazes[0].name}, {task.num_chasers} chaser(s), "
            f"{task.num_evaders} evader(s)"
        )

    @property
    def frames(self) -> int:
        """Steps of all learning agents."""
        return sum(side.learner.frames for side in self.sides.values())

    def policy(self, role: str) -> Policy:
        """The policy of a role that is evaluated (see `Side.evaluated_policy`)."""
        side = self.sides.get(role)
        return self.parts.frozen[role] if side is None else side.evaluated_policy()

    def iterate(self, clock: Clock) -> dict[str, float]:
        """One iteration of every learner; adds snapshots when they are due."""
        figures: dict[str, float] = {}
        progress = clock.progress
        if self.settings.sampling == "psro":  # every best response has its own schedules
            progress = progress * self.settings.snapshots - self.taken
        for role, side in self.sides.items():
            logged = side.iterate(min(max(progress, 0.0), 1.0))
            figures |= {f"{role}_{name}": value for name, value in logged.items()}
        if clock.progress * self.settings.snapshots >= self.taken + 1:
            self.taken = int(clock.progress * self.settings.snapshots)
            self._take_snapshots()
            self.on_snapshot(self)
            if self.settings.sampling == "psro" and clock.progress < 1.0:
                for side in self.sides.values():
                    side.restart()
        self.progress = clock.progress
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
            self.pools[role].add(f"{self.taken:05d}", side.snapshot(), self.rng)
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
        """Exact exploitability where possible, and both sides against scripted agents.

        Exploitability is in discounted steps, lengths are in steps: exact in a duel, and of a team
        up to the size `most` (`match`). With exits both are in captures minus escapes.
        """
        chaser, evader = (self.policy(role) for role in ROLES)
        row = exploited(self.task, chaser, evader, self.parts.discount)
        met = match(self.task, chaser, evader, episodes, most=most)
        row["steps"] = met.steps
        if met.outcome is not None and met.escaped is not None:
            row["outcome"] = met.outcome
            row |= {"capture_rate": met.caught, "escape_rate": met.escaped}
            row["timeout_rate"] = max(1.0 - met.caught - met.escaped, 0.0)
        for name in scripted_references(self.task):
            for role in self.sides:
                other = self.parts.scripted[name, other_role(role)]
                one, two = (chaser, other) if role == "chaser" else (other, evader)
                row[f"{role}_vs_{name}"] = match(self.task, one, two, episodes, most=most).shown
        self.last = row
        return row

    def forget_episodes(self) -> None:
        """As `Trainee`; self-play logs no means over training games."""
        for side in self.sides.values():
            side.env.finished_returns.clear()
            side.env.finished_lengths.clear()

    def log_fields(self, row: dict[str, float]) -> list[str]:
        """As `format_row`."""
        return format_row(row)

    def results(self, episodes: int) -> Plain:
        """Exploitability, matches between all policies, pools; for teams best responses to each
        side, exact if the game is small enough, otherwise approximate, and `team_results`."""
        settings, limits = self.settings, self.limits
        pair, players = {role: self.policy(role) for role in ROLES}, dict[str, dict[str, Policy]]()
        for role in ROLES:
            players[role] = {"learned" if role in self.sides else "frozen": pair[role]}
            for name in scripted_references(self.task, role):
                if (name, role) in self.parts.scripted:
                    players[role][name] = self.parts.scripted[name, role]
        evaluation = dict(self.last) if limits.is_dry_run else {}
        evaluation = evaluation or self.evaluate(episodes, limits.evaluated_work)
        game = {"task": settings.task.task, "maze": self.task.mazes[0].name}
        met = matches(self.task, players, episodes, limits.evaluated_work)
        content = self.content(game, evaluation, {"matches": met})
        limited = any(self.task.hides_from(agent) for agent in self.task.agent_names)
        known = "nash_conv" in evaluation
        exact_team = not self.task.most_exits and is_exact_team(self.task, pair, MAX_FINAL_WORK)
        if limited:
            content["limited_view"] = True  # best responses and values have full view
            report("best responses with a limited view", 0.0)
            intervals = limited_best_responses(self.task, pair, limits.search_seconds)
            content["limited_best_responses"] = intervals
        if not known and not exact_team:
            report("NashConv of the whole game", 0.0)
            most = limits.whole_game_work
            content["whole_game"] = whole_game(self.task, pair, self.parts.discount, most)
        small = self.task.max_cells <= MAX_SNAPSHOT_CELLS
        if known and small and not limited:
            self.add_snapshot_results(content, pair)
        if exact_team:
            solved = is_exact_team(self.task, pair, limits.response_work)
            learned = {role: pair[role] for role in self.sides if solved}
            content["exact_best_response"] = exact_best_responses(self.task, learned)
        how = (episodes, limits.team_work, content.get("exact_best_response", {}))
        content |= team_references(self.task, pair, [*self.sides], *how)
        if not known and not exact_team and settings.best_response_seconds:
            content["approximate_best_response"] = approximate_best_responses(self, episodes)
        return content

    def content(self, game: Plain, evaluation: dict[str, float], played: Plain) -> Plain:
        """The entries of all results: of this game, evaluation and policies against others."""
        sides = [*self.sides.values()]
        updates = (getattr(side.learner, "update_form", "torch") for side in sides)
        return {
            **game,
            "algorithm": ", ".join(side.parts.algorithm.name for side in sides),
            "sampling": self.settings.sampling,
            "seed": self.settings.seed,
            "discount": self.parts.discount,
            "precision": sides[0].parts.build.precision,
            "update": ", ".join(updates),
            "evaluation": evaluation,
            **played,
            "pools": {role: pool.described() for role, pool in self.pools.items()},
            "mixtures": self.mixtures,
        }

    def add_snapshot_results(self, content: Plain, pair: Mapping[str, Any]) -> None:
        """Add `snapshot_results`, and in the evaluation NashConv of the policies that the sampling
        rule converges in: of the mixture (the lower bound), or of the last ones, `pair`."""
        kept = {role: self.pools[role].snapshots for role in self.sides}
        mixtures: Mapping[str, Mapping[str, float]] | None = self.mixtures
        if self.limits.is_dry_run:
            kept = {r: [Member(name, pair[r], False) for name in "ab"] for r in self.sides}
            mixtures = None
        discount, sampling = self.parts.discount, self.settings.sampling
        least = next(iter(self.sides.values())).parts.min_probability
        content |= snapshot_results(self.task, sampling, discount, kept, mixtures, least)
        bounds, evaluation = content.get("mixture_nash_conv"), content["evaluation"]
        evaluation["played_nash_conv"] = bounds[0] if bounds else evaluation["nash_conv"]
        if not isinstance(self.task, GameTask) and not self.task.is_duel:
            return
        fixed = {role: policy for role, policy in pair.items() if role not in self.sides}
        content["nash_conv_of"] = nash_convs_of(
            self.sides, lambda learned: self.nash_conv_of({**fixed, **learned})
        )

    def nash_conv_of(self, pair: Mapping[str, Any]) -> float:
        """Exact NashConv of policies by role, in the unit of `evaluate`."""
        chaser, evader = (pair[role] for role in ROLES)
        return exploited(self.task, chaser, evader, self.parts.discount)["nash_conv"]

    def brief(self) -> SelfPlay:
        """As `Trainee`."""
        small = copy(self)
        small.task = replace(self.task, max_steps=min(self.task.max_steps, BRIEF_STEPS))
        small.limits = DRY_RUN
        return small

    # -- files -----------------------------------------------------------------------------------

    def state_dict(self) -> State:
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

    def learned(self) -> State:
        """The states of the learners."""
        return {role: side.learner.state_dict() for role, side in self.sides.items()}

    def _load_state_dict(self, state: State) -> None:
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

    def save_beside(self, folder: Path) -> None:
        """Write every role as a separate policy, and delete snapshots that are in no pool."""
        for role, side in self.sides.items():
            own = folder / role
            if not (own / CONFIG).exists():
                own.mkdir(exist_ok=True)
                maze = self.settings.task.maze_text
                save_config(own, SIDE, side_settings(self.settings, role), maze)
            learner = side.learner.state_dict() | side.snapshot()
            name = side.parts.algorithm.name
            state = {"algorithm": name, "game": game_digest(side.parts.seat), "learner": learner}
            save_checkpoint(own, {"trainee": state})
        for pool in self.pools.values():
            pool.clean()

    def close(self) -> None:
        """Close the learners."""
        for side in self.sides.values():
            side.learner.close()
