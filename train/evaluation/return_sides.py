"""Sides of games that are measured in returns: of any kind of game, and of small games."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.replays.viewer.data import Builder
from pursuit.validation import Missing, check
from scripted_agents.exact.references import ReturnSolver
from scripted_agents.games.episodes import play_of, return_range
from scripted_agents.games.mixing import mixed_share
from scripted_agents.games.simulator import GameTask
from scripted_agents.games.small_game import KEPT
from scripted_agents.games.solve import (
    SmallEquilibrium,
    equilibrium,
    nash_conv,
    respond,
    returns_of,
)
from scripted_agents.names import EQUILIBRIUM
from scripted_agents.names import GAME_AGENTS as AGENTS
from train.evaluation.games import half_width, stepper
from train.evaluation.scores import Measure
from train.evaluation.self_play_text import EXPLOITABILITY, describe_snapshots, describe_time
from train.evaluation.sides import (
    PAIR_EPISODES,
    EndTable,
    Gain,
    PairResult,
    Policies,
    PolicyTable,
    Profile,
    Reply,
    ResultLimits,
    Sides,
    known,
)
from train.evaluation.small_game_replay import add_small_game
from train.evaluation.text_replay import add_text_episodes
from train.files import Plain
from train.networks.recurrent_policy import without_improbable
from train.reports.curves import Panel, Series
from train.reports.figures import PALETTE
from train.reports.tables import ResultTable, Row, numeric, words
from train.settings.checks import EVALUATION_SEED
from train.settings.task import GAME

OPPOSITE = "needs two players with opposite rewards"
MOST_SOLVED = 100_000
"""Joint actions of a zero-sum game up to which its equilibrium is computed: seconds."""
MOST_MIXED = 50_000
"""Joint actions of a small game up to which bounds of mixtures are computed: minutes at most."""


class ReturnSides(Sides):
    """The agents of a game of any kind by returns within the time limit; each is a side, or all of
    a role, whose return is the sum of those of its agents.

    Exact where the family has a solver (`GameWorld.solver`), otherwise sampled.
    """

    @property
    def by_agent(self) -> tuple[str, ...]:
        """As of `Sides`: the roles."""
        return tuple(self.task.seat_roles)

    def agents(self, policies: Policies) -> dict[str, Any]:
        """The policies of all agents by name."""
        named = zip(self.task.agent_names, self.by_agent, strict=True)
        return {name: policies[role] for name, role in named}

    def of_sides(self, returns: Any) -> PolicyTable:
        """[..., sides] the returns of sides from those of agents [..., agents]."""
        found = np.asarray(returns, dtype=np.float64)
        each = [np.array([own == role for own in self.by_agent]) for role in self.roles]
        return np.stack([found[..., own].sum(axis=-1) for own in each], axis=-1)

    def why_not(self, policies: Policies) -> str | None:
        """Why results of these policies are not exact; None if they are."""
        solver: ReturnSolver | Missing = self.world.solver
        if isinstance(solver, Missing):
            return solver.reason
        return solver.why_not(self.task, self.agents(policies) if policies else {})

    def line(self) -> str:
        """As of `Sides`."""
        return f"game {self.task.name}, {', '.join(self.roles)}"

    def describe_game(self) -> Plain:
        """As of `Sides`."""
        task, roles = self.world.settings.task, list(self.roles)
        game = {"task": task, "game": self.task.name, "maze": None, "players": roles}
        return {**game, "zero_sum": self.world.ZERO_SUM}

    @property
    def mixtures(self) -> bool | Missing:
        """As of `Sides`: in a zero-sum game."""
        return self.world.ZERO_SUM or Missing(OPPOSITE)

    def scripted(self, members: Sequence[str]) -> dict[tuple[str, str], Any]:
        """As of `Sides`: all named policies."""
        names = dict.fromkeys((*self.world.policy_names, *members))
        return {(name, role): self.world.named(name, role) for role in self.roles for name in names}

    def scores(self, batch: Any, role: str, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        """As of `Sides`."""
        return self.scores_of_returns(role, batch.returns[games])

    def scores_of_returns(self, role: str, returns: NDArray[np.float64]) -> NDArray[np.float64]:
        """[n] the scores in [0, 1] of a side in episodes with these returns [n, agents]: 1 for a
        mean return above that of all agents, 0 for one below it, 1/2 for one equal to it."""
        own = [seat for seat, side in enumerate(self.by_agent) if side == role]
        lead = returns[:, own].mean(axis=1) - returns.mean(axis=1)
        return np.asarray(0.5 + 0.5 * np.sign(np.where(np.abs(lead) < 1e-9, 0.0, lead)))

    # -- results ---------------------------------------------------------------------------------

    def sampled(
        self, policies: Policies, episodes: int, seed: int
    ) -> tuple[PolicyTable, PolicyTable]:
        """[episodes, sides] returns, and [episodes] steps, of sampled episodes."""
        batch = self.world.BATCH(self.task, episodes, seed, auto_restart=False)
        step = stepper(batch, [policies[role] for role in self.by_agent])
        while not batch.ended.all():
            step()
        returns = self.of_sides(batch.returns)
        check(
            not self.world.ZERO_SUM or bool(np.allclose(returns.sum(axis=1), 0.0, atol=1e-5)),
            f"returns of game {self.task.name!r} do not add up to 0; leave ZERO_SUM out",
        )
        return returns, batch.steps.astype(np.float64)

    def means(
        self, policies: Policies, episodes: int, seed: int = EVALUATION_SEED
    ) -> tuple[float, ...]:
        """The mean return of every side; exact if it can be."""
        if self.why_not(policies) is None:
            exact = self.world.solver.returns(self.task, self.agents(policies))
            return tuple(self.of_sides(exact).tolist())
        return tuple(self.sampled(policies, episodes, seed)[0].mean(axis=0).tolist())

    def payoff(self, one: Any, two: Any, seed: int) -> float:
        """As of `Sides`: the return of the second side."""
        return self.means(dict(zip(self.roles, (one, two), strict=True)), PAIR_EPISODES, seed)[1]

    def objective(self, policies: Policies) -> Measure:
        """As of `Sides`: NashConv, or the return of the first side."""
        if self.why_not(policies) is None:
            return Measure("nash_conv", "return")
        first = self.roles[0]
        return Measure(f"{first}_return", f"return of {first}", less_is_better=False)

    def exact(self, policies: Policies) -> dict[str, float]:
        """NashConv, the return of every side, and the gain of its best response; {} where they are
        not known."""
        if self.why_not(policies) is not None:
            return {}
        task, solver, agents = self.task, self.world.solver, self.agents(policies)
        returns = dict(zip(self.roles, self.means(policies, 0), strict=True))
        best = {role: solver.respond(task, role, agents)[0] for role in self.roles}
        gains = {role: max(float(best[role] - returns[role]), 0.0) for role in self.roles}
        return {
            "nash_conv": sum(gains.values()),
            **{f"{role}_return": float(value) for role, value in returns.items()},
            **{f"{role}_gain": gain for role, gain in gains.items()},
        }

    def evaluate(self, profile: Profile, episodes: int, most: int = 0) -> dict[str, float]:
        """As of `Sides`: NashConv where it is known, and returns, also against the first named
        policy."""
        returns, steps = self.sampled(profile.policies, episodes, profile.seed)
        row = self.exact(profile.policies)
        for role, mean in zip(self.roles, returns.mean(axis=0).tolist(), strict=True):
            row.setdefault(f"{role}_return", mean)
        row |= self.against_named(profile, episodes)
        row["steps"] = float(steps.mean())
        return row

    def against_named(self, profile: Profile, episodes: int) -> dict[str, float]:
        """The return of every learning side where all others play the first named policy."""
        name, row = self.world.policy_names[0], {}
        for number, role in enumerate(self.roles):
            if role in profile.learning:
                others = {other: profile.scripted[name, other] for other in self.roles}
                played = {**others, role: profile.policies[role]}
                row[f"{role}_vs_{name}"] = self.means(played, episodes, profile.seed)[number]
        return row

    def fields(self, row: Mapping[str, float]) -> list[str]:
        """As of `Sides`: NashConv, the return of every side, and the steps of an episode."""
        parts = [f"NashConv {row['nash_conv']:z8.4f}"] if "nash_conv" in row else []
        parts += [f"{role} {row[f'{role}_return']:z7.3f}" for role in self.roles]
        return [*parts, f"{row['steps']:6.1f} steps"]

    def played(self, profile: Profile, episodes: int, limits: ResultLimits) -> Plain:
        """As of `Sides`: for each side the returns of its policies against each named policy of all
        others.

        Rows: "player", "policy" (learned, frozen, or a name), "against" (learned or a name), and
        "return".
        """
        learned, rows = profile.policies, list[Plain]()
        names: list[str] = [*dict.fromkeys(name for name, _ in profile.scripted)]
        named = {n: {role: profile.scripted[n, role] for role in self.roles} for n in names}
        for number, role in enumerate(self.roles):
            own = "learned" if role in profile.learning else "frozen"
            for policy, mine in {own: learned, **named}.items():
                for against, theirs in {"learned": learned, **named}.items():
                    value = self.means({**theirs, role: mine[role]}, episodes)[number]
                    rows.append(
                        {"player": role, "policy": policy, "against": against, "return": value}
                    )
        why = self.why_not(learned)
        return {"returns": rows} if why is None else {"returns": rows, "not_exact": why}

    def more(
        self,
        content: Plain,
        profile: Profile,
        episodes: int,
        limits: ResultLimits,
        add_snapshots: Callable[[], None],
        respond: Callable[[str], Any] | None,
    ) -> None:
        """As of `Sides`: where results are not exact, returns of trained best responses."""
        super().more(content, profile, episodes, limits, add_snapshots, respond)
        if "nash_conv" in content["evaluation"] or respond is None or len(self.roles) != 2:
            return
        content["approximate_best_response"] = {
            f"against_{role}": self.means(respond(role), episodes)[1 - self.roles.index(role)]
            for role in profile.learning
        }

    def why_not_always(self) -> str | None:
        """As of `Sides`."""
        return self.why_not({})

    def nash_conv(self, policies: Policies) -> float | Missing:
        """As of `Sides`."""
        why = self.why_not(policies)
        return self.exact(policies)["nash_conv"] if why is None else Missing(why)

    # -- leagues ---------------------------------------------------------------------------------

    def pair(self, one: Any, two: Any, games: int, seed: int, most: int) -> PairResult:
        """As of `Sides`: returns; those of both sides, unless their sum is always 0."""
        policies = dict(zip(self.roles, (one, two), strict=True))
        found = self.sampled(policies, games, seed)[0].round(9)  # so that equal ones are
        if self.why_not(policies) is None:
            (first, second), half = self.means(policies, games, seed), 0.0
        else:
            (first, second), half = found.mean(axis=0).tolist(), half_width(found[:, 1])
        return PairResult(second, half, found[:, 1], None if self.world.ZERO_SUM else first)

    @property
    def league_measure(self) -> Measure:
        """As of `Sides`."""
        return Measure("mean_return", f"return of {self.roles[1]}")

    # -- in words --------------------------------------------------------------------------------

    def describe(self, content: Plain) -> list[str]:
        """As of `Sides`."""
        found = content["evaluation"]
        if "nash_conv" in found:
            return describe_returns({**content, "discount": 1.0})
        each = ", ".join(f"{role} {found[f'{role}_return']:z.4f}" for role in self.roles)
        lines = [f"Returns: {each}, sampled. No exact NashConv: {content['not_exact']}."]
        for name, value in content.get("approximate_best_response", {}).items():
            against = name.replace("_", " the ")
            lines.append(f"Approximate best response {against}: return {value:z.4f}.")
        return [*lines, *describe_time(content)]

    def tables(self, content: Plain) -> list[EndTable]:
        """As of `Sides`: the returns."""
        return [EndTable("Returns at the end", returns_table(content))]

    def panels(self, rows: Sequence[Mapping[str, float]], unit: str) -> list[Panel]:
        """As of `Sides`: NashConv, and the gain of every side's best response; where they are not
        known returns."""
        exact = "nash_conv" in rows[0]
        lines = {"nash_conv": EXPLOITABILITY["nash_conv"]} if exact else {}
        column, what = ("gain", "gain of a best response of") if exact else ("return", "return of")
        for name, color in zip(self.roles, PALETTE[:6] * len(self.roles), strict=False):
            lines[f"{name}_{column}"] = Series((), f"{what} {name}", color, "--", 1.3)
        label = "return, exact" if exact else "return, sampled"
        scale: Any = "from 0" if exact else "linear"
        return [Panel(known(rows, unit, lines), label, scale=scale)]

    def add_episodes(
        self,
        builder: Builder,
        policies: Policies,
        games: Mapping[str, int],
        labels: Mapping[str, str],
    ) -> None:
        """As of `Sides`, as text."""
        start = partial(self.world.BATCH, self.task, 1, EVALUATION_SEED, auto_restart=False)
        played = [policies[role] for role in self.by_agent]
        add_text_episodes(builder, start, played, games, [labels[role] for role in self.by_agent])


class SmallGameSides(ReturnSides):
    """The players of a small game, exactly.

    Returns have the discount of the learners; without discount (1) they are those within
    `max_steps`, and best responses may depend on time.
    """

    task: GameTask

    def why_not(self, policies: Policies) -> None:
        """As of `ReturnSides`: all results are exact."""

    @property
    def mixtures(self) -> bool | Missing:
        """As of `Sides`: in a zero-sum game of two."""
        return self.task.game.zero_sum or Missing(OPPOSITE)

    def line(self) -> str:
        """As of `Sides`."""
        game = self.task.game
        return (
            f"game {self.task.name} ({game.num_states:,} states, {len(game.choices):,} joint "
            f"actions), {', '.join(self.roles)}"
        )

    def describe_game(self) -> Plain:
        """As of `Sides`: its name, size, players, the range of the returns of the first, and in a
        zero-sum game of two whose value is computed how much an equilibrium mixes."""
        task, game = self.task, self.task.game
        low, high = return_range(game, game.players[0], self.discount, task.horizon(self.discount))
        return {
            "task": GAME,
            "game": task.name,
            "maze": None,
            "states": game.num_states,
            "players": list(task.agent_names),
            "zero_sum": game.zero_sum,
            "payoff_range": high - low,
            "mixed_share": self.mixed_share(),
        }

    def scripted(self, members: Sequence[str]) -> dict[tuple[str, str], Any]:
        """As of `Sides`; equilibria in zero-sum games."""
        known_here = [name for name in AGENTS if self.task.game.zero_sum or name != EQUILIBRIUM]
        names = dict.fromkeys((*known_here, *members))
        return {(name, role): self.world.named(name, role) for role in self.roles for name in names}

    def scale(self, role: str) -> float:
        """As of `Sides`: all returns lie in [-1, 1]."""
        return reward_scale(self.task, role, self.discount)

    def scores_of_returns(self, role: str, returns: NDArray[np.float64]) -> NDArray[np.float64]:
        """As of `ReturnSides`; in a zero-sum game of two the return as a share of its range within
        the time limit, so that they also differ where one player never has a return above 0."""
        if not self.task.game.zero_sum:
            return super().scores_of_returns(role, returns)
        low, high = range_of_returns(self.task, role)
        own = returns[:, self.task.seat(role)]
        return np.clip((own - low) / max(high - low, 1e-9), 0.0, 1.0)

    def tables_of(self, policies: Policies) -> dict[str, PolicyTable]:
        """The tables of policies by player."""
        return {role: policies[role].table(self.task) for role in self.roles}

    def means(
        self, policies: Policies, episodes: int = 0, seed: int = EVALUATION_SEED
    ) -> tuple[float, ...]:
        """As of `ReturnSides`, with the discount."""
        game, tables = self.task.game, self.tables_of(policies)
        found = returns_of(game, tables, self.discount, self.task.horizon(self.discount))
        return tuple((game.start @ found).tolist())

    def exact(self, policies: Policies) -> dict[str, float]:
        """As of `ReturnSides`; in a small zero-sum game of two also its value and the
        exploitability of each."""
        task, game, tables = self.task, self.task.game, self.tables_of(policies)
        found = nash_conv(game, tables, self.discount, task.horizon(self.discount))
        row = {"nash_conv": found.nash_conv}
        row |= {f"{role}_return": found.returns[role] for role in self.roles}
        row |= {f"{role}_gain": found.gains[role] for role in self.roles}
        if game.zero_sum and len(game.choices) <= MOST_SOLVED:
            (first, second), value = self.roles, solved(task, self.discount).mean_over_starts
            row["game_value"] = value
            row[f"{first}_exploitability"] = found.best[second] + value
            row[f"{second}_exploitability"] = found.best[first] - value
        return row

    def evaluate(self, profile: Profile, episodes: int, most: int = 0) -> dict[str, float]:
        """As of `ReturnSides`, all exact."""
        row = self.exact(profile.policies)
        tables = self.tables_of(profile.policies)
        row["steps"] = play_of(self.task.game, tables, self.task.max_steps).steps
        return row | self.against_named(profile, episodes)

    def mixed_share(self) -> float | None:
        """As of `Sides`; in zero-sum games of two whose value is computed."""
        task, discount = self.task, self.discount
        if not task.game.zero_sum or len(task.game.choices) > MOST_SOLVED:
            return None
        return mixed_share(task.game, discount, task.horizon(discount), solved(task, discount))

    # -- mixtures of snapshots -------------------------------------------------------------------

    def are_tables(self, policies: Sequence[Any]) -> bool:
        """As of `Sides`: in zero-sum games of two of limited size."""
        return self.task.game.zero_sum and len(self.task.game.choices) <= MOST_MIXED

    def table(self, policy: Any, least: float) -> PolicyTable:
        """As of `Sides`: [pairs] of a state and an action, as of `SmallGame.table`."""
        likely = without_improbable(policy.state_probabilities(), least)
        return self.task.flat(policy.agent, likely)

    def replies(self, role: str) -> tuple[Reply, Gain]:
        """As of `Sides`, in returns."""
        game, discount, horizon = self.task.game, self.discount, self.task.horizon(self.discount)
        other = next(name for name in game.players if name != role)
        seat, value = game.player(other), solved(self.task, discount).mean_over_starts
        value = value if seat == 0 else -value

        def reply(table: PolicyTable) -> tuple[PolicyTable, float]:
            best = respond(game, other, {role: table}, discount, horizon)
            return best.policies[other], best.mean_over_starts - value

        def gain(table: PolicyTable, response: PolicyTable) -> float:
            found = returns_of(game, {role: table, other: response}, discount, horizon)
            return float(game.start @ found[:, seat]) - value

        return reply, gain

    # -- leagues ---------------------------------------------------------------------------------

    def pair(self, one: Any, two: Any, games: int, seed: int, most: int) -> PairResult:
        """As of `Sides`: exact returns within the time limit; in a zero-sum game there are also
        sampled games, from the same starts for all pairs, for ratings."""
        task, policies = self.task, dict(zip(self.roles, (one, two), strict=True))
        exact = play_of(task.game, self.tables_of(policies), task.max_steps).returns
        if not task.game.zero_sum:
            return PairResult(float(exact[1]), 0.0, np.zeros(0), float(exact[0]))
        found = self.sampled(policies, games, seed)[0][:, 1]
        return PairResult(float(exact[1]), 0.0, found.round(9))  # so that equal ones are

    def describe(self, content: Plain) -> list[str]:
        """As of `Sides`."""
        return describe_returns(content)

    def add_episodes(
        self,
        builder: Builder,
        policies: Policies,
        games: Mapping[str, int],
        labels: Mapping[str, str],
    ) -> None:
        """As of `Sides`, with exact values and best responses."""
        add_small_game(builder, self.task, policies, games, self.discount, labels)


@lru_cache(maxsize=2 * KEPT)
def reward_scale(task: GameTask, player: str, discount: float) -> float:
    """The factor of a player's rewards in training with which all its returns lie in [-1, 1].

    They are the units of the coefficients of losses; large returns would make the value loss
    dominate. Without discount (1) returns are those within `max_steps`.
    """
    horizon = task.horizon(discount)
    largest = float(np.abs(return_range(task.game, player, discount, horizon)).max())
    return 1.0 / largest if largest > 0.0 else 1.0


@lru_cache(maxsize=2 * KEPT)
def range_of_returns(task: GameTask, player: str) -> tuple[float, float]:
    """The least and the largest expected return of a player within the time limit, whatever all
    play, without discount."""
    return return_range(task.game, player, 1.0, task.max_steps)


@lru_cache(maxsize=4)
def solved(task: GameTask, discount: float) -> SmallEquilibrium:
    """The equilibrium of a zero-sum small game, computed once."""
    return equilibrium(task.game, discount, task.horizon(discount))


# -- in words --------------------------------------------------------------------------------------


def returns_table(results: Plain) -> ResultTable:
    """The returns of every player: a row for each of its policies, a column for each of those of
    all others."""
    rows: dict[tuple[str, str], Row] = {}
    for entry in results["returns"]:
        key = (entry["player"], entry["policy"])
        row = rows.setdefault(key, {"player": key[0], "policy": key[1]})
        row[f"against {entry['against']}"] = entry["return"]
    against = list(dict.fromkeys(entry["against"] for entry in results["returns"]))
    columns = [numeric(f"against {name}", f"against {name}", "z.4f") for name in against]
    return ResultTable([*rows.values()], [words("player"), words("policy"), *columns])


def describe_returns(results: Plain) -> list[str]:
    """Exact results as sentences: NashConv, gains of best responses, and the game's value."""
    found, start = results["evaluation"], results.get("at_start", {})
    discount, players = results["discount"], results["players"]
    how = "undiscounted" if discount == 1.0 else f"discounted by {discount:g} per step"
    before = f" (at the start {start['nash_conv']:z.4f})" if "nash_conv" in start else ""
    zero = (
        "0 is an equilibrium" if results["zero_sum"] else "at 0 no player gains by another policy"
    )
    gains = ", ".join(f"{name} {found[f'{name}_gain']:z.4f}" for name in players)
    lines = [
        f"NashConv {found['nash_conv']:z.4f}{before}, exact, in returns {how}; {zero}.",
        f"Gain, by which a best response of the player beats its policy: {gains}.",
    ]
    if "game_value" in found:
        each = ", ".join(f"{name} {found[f'{name}_exploitability']:z.4f}" for name in players)
        lines.append(
            f"Return of {players[0]}: {found[f'{players[0]}_return']:z.4f}; value of the game: "
            f"{found['game_value']:z.4f}. Exploitability, lost to a best response: "
            f"{each}."
        )
    return [*lines, *describe_snapshots(results), *describe_time(results)]
