"""Chasers against evaders in a maze, in steps or outcomes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder, Extras
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import Missing
from scripted_agents import PairValues, mean_over_starts, solve_chase
from scripted_agents.environments import custom_policy, scripted_policy
from scripted_agents.exact.limits import MAX_EVALUATED_WORK, MAX_FINAL_WORK, MAX_SNAPSHOT_CELLS
from scripted_agents.exact.long_work import report
from scripted_agents.exact.references import is_exact_team, is_table_duel
from scripted_agents.games import game_of_sides
from scripted_agents.games.mixing import mixed_share
from scripted_agents.names import AGENTS, custom_roles, plays
from train.evaluation.contest import GameContest
from train.evaluation.departures import rates_of
from train.evaluation.diversity import diversity_of
from train.evaluation.games import (
    all_caught,
    best_reply,
    half_width,
    order_of,
    other_role,
    table_in,
    values_between,
)
from train.evaluation.matchups import discounted_steps, exact_match, match, pair_payoffs
from train.evaluation.payoff_table import legend_of, matches_table
from train.evaluation.recordings import MOST_OVERLAY_CELLS, recorded
from train.evaluation.scores import BY_OUTCOME, DISCOUNTED, OUTCOME, UNTIL_CAPTURE, Measure
from train.evaluation.self_play_metrics import (
    exact_best_responses,
    exploited,
    format_row,
    limited_best_responses,
    matches,
    nash_conv_solver,
    scripted_references,
    team_references,
    whole_game,
)
from train.evaluation.self_play_text import (
    AGAINST_SCRIPTED,
    EXPLOITABILITY,
    describe_exploitability,
)
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
from train.evaluation.team_contest import TeamContest
from train.files import Plain
from train.networks.recurrent_policy import without_improbable
from train.reports.curves import Panel
from train.reports.tables import ResultTable, Row
from train.settings.self_play import OPPOSING_ROLES

SHORT = 20
"""Default number of steps of training episodes without goals. Where the evader can escape, episodes
of full length would hardly visit the states in which it is caught."""
MOST_STATES = 2_500
"""States of a game up to which it is solved before training: about a second."""


class MazeSides(Sides):
    """Chasers against evaders in one maze."""

    bounded: ClassVar[bool] = False  # the games have a discount

    task: Task

    @property
    def by_agent(self) -> tuple[str, ...]:
        """As of `Sides`: the roles."""
        return self.task.seat_roles

    def line(self) -> str:
        """As of `Sides`."""
        task = self.task
        return (
            f"{task.name} on maze {task.mazes[0].name}, {task.num_chasers} chaser(s), "
            f"{task.num_evaders} evader(s)"
        )

    def describe_game(self) -> Plain:
        """As of `Sides`."""
        return {"task": self.world.settings.task, "maze": self.task.mazes[0].name}

    def place(self) -> str:
        """As of `Sides`."""
        return f"on maze {self.task.mazes[0].name}"

    # -- for learning ----------------------------------------------------------------------------

    def scripted(self, members: Sequence[str]) -> dict[tuple[str, str], Any]:
        """As of `Sides`; random moves are a setting of A*."""
        found, task, order = dict[tuple[str, str], Any](), self.task, order_of(self.task)
        for name in AGENTS:
            epsilon = self.world.settings.opponent_epsilon if name == "astar" else 0.0
            for role in OPPOSING_ROLES:
                if plays(name, task, role):
                    found[name, role] = scripted_policy(name, role, epsilon, order, self.discount)
        for name in members:
            if name not in AGENTS:
                for role in custom_roles(name, task):
                    found[name, role] = custom_policy(name, task, role)
        return found

    def episode_steps(self, given: int | None) -> int:
        """As of `Sides`."""
        return given or (self.task.max_steps if self.task.num_goals else SHORT)

    def scale(self, role: str) -> float:
        """As of `Sides`: returns of up to 1 / (1 - discount) steps would make the value loss
        dominate."""
        return 1.0 - self.discount if self.world.settings.rewards == "zero_sum" else 1.0

    def scores(self, batch: Simulator, role: str, games: NDArray[np.bool_]) -> PolicyTable:
        """As of `Sides`.

        The score of an evader is 1 - discount ** steps, its share of the highest discounted return;
        that of a chaser is discount ** steps. With exits a chaser scores 1 for a game that ends by
        a capture, 0 for one that ends by an escape, 1/2 if time is up.
        """
        task = batch.task
        rounds = -(-batch.steps[games] // task.steps_per_round)
        left = self.discount ** rounds.astype(np.float64)
        if task.most_exits:  # the escapes of the last step, as `Payoffs` counts games to their end
            won = all_caught(batch)[games].astype(np.float64)
            left = np.where(batch.terminated[games], won, 0.5)
        return np.asarray(left if role == "chaser" else 1.0 - left)

    # -- results ---------------------------------------------------------------------------------

    def objective(self, policies: Policies) -> Measure:
        """As of `Sides`; it depends on the game alone: every learned policy is a table."""
        if nash_conv_solver(self.task, policies) == "none":
            return Measure("steps", "steps")
        return Measure("nash_conv", OUTCOME if self.task.most_exits else DISCOUNTED)

    def payoff(self, one: Any, two: Any, seed: int) -> float:
        """As of `Sides`: `discounted_steps`."""
        return discounted_steps(self.task, one, two, self.discount, PAIR_EPISODES, seed)

    def evaluate(self, profile: Profile, episodes: int, most: int = 0) -> dict[str, float]:
        """As of `Sides`: exact exploitability where possible, and sides against scripted agents.

        Exploitability is in discounted steps, lengths are in steps: exact in a duel, and of a team
        up to the size `most` (`match`). With exits both are in captures minus escapes.
        """
        task = self.task
        chaser, evader = (profile.policies[role] for role in OPPOSING_ROLES)
        row = exploited(task, chaser, evader, self.discount)
        met = match(task, chaser, evader, episodes, most, profile.seed)
        row["steps"] = met.steps
        if met.escaped is not None:
            row |= rates_of(met.caught, met.escaped, task.num_evaders)
        for name in scripted_references(task):
            for role in profile.learning:
                other = profile.scripted[name, other_role(role)]
                one, two = (chaser, other) if role == "chaser" else (other, evader)
                result = match(task, one, two, episodes, most, profile.seed)
                row[f"{role}_vs_{name}"] = result.shown
        return row

    def fields(self, row: Mapping[str, float]) -> list[str]:
        """As of `Sides`."""
        return format_row(row)

    def played(self, profile: Profile, episodes: int, limits: ResultLimits) -> Plain:
        """As of `Sides`: matches between all policies."""
        players = dict[str, dict[str, Any]]()
        for role in OPPOSING_ROLES:
            own = "learned" if role in profile.learning else "frozen"
            players[role] = {own: profile.policies[role]}
            for name in scripted_references(self.task, role):
                if (name, role) in profile.scripted:
                    players[role][name] = profile.scripted[name, role]
        return {"matches": matches(self.task, players, episodes, limits.evaluated_work)}

    def more(
        self,
        content: Plain,
        profile: Profile,
        episodes: int,
        limits: ResultLimits,
        add_snapshots: Callable[[], None],
        respond: Callable[[str], Any] | None,
    ) -> None:
        """As of `Sides`: for teams best responses to each side, exact if the game is small enough,
        otherwise approximate, and `team_results`; with limited views intervals."""
        task, pair = self.task, profile.policies
        limited = any(task.hides_from(agent) for agent in task.agent_names)
        exact = "nash_conv" in content["evaluation"]
        exact_team = not task.most_exits and is_exact_team(task, pair, MAX_FINAL_WORK)
        if limited:
            content["limited_view"] = True  # best responses and values have full view
            report("best responses with a limited view", 0.0)
            intervals = limited_best_responses(task, pair, limits.search_seconds)
            content["limited_best_responses"] = intervals
        if not exact and not exact_team:
            report("NashConv of the whole game", 0.0)
            most = limits.whole_game_work
            content["whole_game"] = whole_game(task, pair, self.discount, most)
        if exact and task.max_cells <= MAX_SNAPSHOT_CELLS and not limited:
            add_snapshots()
        if exact_team:
            solved = is_exact_team(task, pair, limits.response_work)
            learned = {role: pair[role] for role in profile.learning if solved}
            content["exact_best_response"] = exact_best_responses(task, learned)
        how = (episodes, limits.team_work, content.get("exact_best_response", {}))
        content |= team_references(task, pair, profile.learning, *how)
        if not exact and not exact_team and respond is not None:
            steps = {}
            for role in profile.learning:
                chaser, evader = (respond(role)[side] for side in OPPOSING_ROLES)
                steps[f"against_{role}"] = match(task, chaser, evader, episodes).shown
            content["approximate_best_response"] = steps

    def nash_conv(self, policies: Policies) -> float | Missing:
        """As of `Sides`."""
        chaser, evader = (policies[role] for role in OPPOSING_ROLES)
        row = exploited(self.task, chaser, evader, self.discount)
        return row.get("nash_conv", Missing("this game, or one of these policies, is not solved"))

    def why_not_always(self) -> str | None:
        """As of `Sides`."""
        return None if self.task.is_duel else "use one chaser against one evader"

    @property
    def compares_weights(self) -> bool:
        """As of `Sides`: in duels."""
        return self.task.is_duel

    def mixed_share(self) -> float | None:
        """As of `Sides`; unknown in large games, with limited views, goals or exits, and with other
        rewards."""
        task = self.task
        limited = any(task.hides_from(agent) for agent in task.agent_names)
        if task.rewards != "zero_sum" or limited or task.num_goals or task.most_exits:
            return None
        if task.options.turns:
            return 0.0  # each side sees the other's move, so that pure play is optimal
        try:
            game = game_of_sides(replace(task, max_steps=1), MOST_STATES)
        except ValueError:
            return None
        return mixed_share(game, self.discount)

    # -- mixtures of snapshots -------------------------------------------------------------------

    def are_tables(self, policies: Sequence[Any]) -> bool:
        """As of `Sides`: in a small duel."""
        return is_table_duel(self.task, *policies)

    def table(self, policy: Any, least: float) -> PolicyTable:
        """As of `Sides`: [own cell, other cell, action]."""
        return without_improbable(table_in(self.task, policy), least)

    def replies(self, role: str) -> tuple[Reply, Gain]:
        """As of `Sides`, in discounted steps, over starts in distinct cells."""
        task, discount = self.task, self.discount
        maze, sign, other = task.mazes[0], 1.0 if role == "chaser" else -1.0, other_role(role)
        game = solve_chase(maze, discount, task.stay_action, None, order_of(task))
        value = mean_over_starts(game.values, maze)

        def gained(values: PolicyTable | PairValues) -> float:
            return sign * (mean_over_starts(values, maze) - value)

        def reply(table: PolicyTable) -> tuple[PolicyTable, float]:
            best = best_reply(task, other, table, None, discount)
            return best.policy, gained(best.values)

        def gain(table: PolicyTable, response: PolicyTable) -> float:
            return gained(values_between(task, role, (table, response), None, discount))

        return reply, gain

    def diversity(self, kept: Mapping[str, Sequence[Any]]) -> Plain:
        """As of `Sides`: `diversity_of`."""
        return {"diversity": diversity_of(self.task, self.discount, kept)}

    # -- leagues ---------------------------------------------------------------------------------

    def pair(self, one: Any, two: Any, games: int, seed: int, most: int) -> PairResult:
        """As of `Sides`: steps until capture, with exits escapes minus captures."""
        sampled = pair_payoffs(self.task, one, two, games, seed)
        exact = exact_match(self.task, {"chaser": one, "evader": two}, most)
        if exact is not None:
            return PairResult(exact.payoff, 0.0, sampled)
        return PairResult(float(sampled.mean()), half_width(sampled), sampled)

    @property
    def league_measure(self) -> Measure:
        """As of `Sides`."""
        return BY_OUTCOME if self.task.most_exits else UNTIL_CAPTURE

    @property
    def horizon(self) -> int | None:
        """As of `Sides`; none with exits."""
        return None if self.task.most_exits else self.task.max_steps

    def team_rows(self, entries: Sequence[Any], table: Any) -> list[Row]:
        """Every team of several agents against every policy of the other role, with its best
        response.

        Returns:
            Rows with "role", "team", "against"; "payoff" and "ci95" of the table; "best_response"
            of the team as one player (with full view), in the unit of the table and over all
            starts, and "gap" (`Measure.gap`); or None and the "reason".
        """
        rows: list[Row] = []
        for role in [role for role in OPPOSING_ROLES if self.task.count(role) > 1]:
            for other in [entry for entry in entries if entry.role == other_role(role)]:
                how: Plain = {"most_work": MAX_EVALUATED_WORK}
                contest = TeamContest(self.task, role, {other.role: other.policy}, **how)
                best = contest.best
                for entry in [entry for entry in entries if entry.role == role]:
                    names = {role: entry.name, other.role: other.name}
                    place = (
                        table.chasers.index(names["chaser"]),
                        table.evaders.index(names["evader"]),
                    )
                    payoff = float(table.shown[place])
                    gap = None if best is None else contest.measure.gap(payoff, best)
                    rows.append(
                        {
                            "role": role,
                            "team": entry.name,
                            "against": other.name,
                            "payoff": payoff,
                            "ci95": float(table.ci95[place]),
                            "best_response": best,
                            "gap": gap,
                            "full_view": contest.is_limited,
                            "reason": contest.full.exact_reference.reason,
                        }
                    )
        return rows

    # -- in words --------------------------------------------------------------------------------

    def describe(self, content: Plain) -> list[str]:
        """As of `Sides`."""
        return describe_exploitability(content)

    def tables(self, content: Plain) -> list[EndTable]:
        """As of `Sides`: the matches."""
        met = content["matches"]
        exact = not any(row["games"] for row in met)
        exits = any("outcome" in row for row in met)
        how = "exact" if exact else "sampled" if exits else "± is the 95 % interval"
        unit, most = (BY_OUTCOME if exits else UNTIL_CAPTURE).unit, self.task.max_steps
        return [
            EndTable(
                "Matches at the end",
                matches_table(met),
                f"{unit}, at most {most} ({how}); rows: chasers, columns: evaders",
                self.legend(
                    [row[role] for row in met for role in OPPOSING_ROLES],
                    self.world.settings.opponent_epsilon,
                ),
                f"Mean {self.league_measure.unit}.",
            )
        ]

    def files(self, content: Plain) -> dict[str, ResultTable]:
        """As of `Sides`."""
        return {"table": matches_table(content["matches"])}

    def panels(self, rows: Sequence[Mapping[str, float]], unit: str) -> list[Panel]:
        """As of `Sides`: exploitability, and below it both sides against the scripted agents."""
        exits = "outcome" in rows[0]
        label, scale = (OUTCOME, "linear") if exits else ("steps until capture (log)", "log")
        panels = [Panel(known(rows, unit, AGAINST_SCRIPTED), label, scale=scale)]
        if exploitability := known(rows, unit, EXPLOITABILITY):
            unit_of = OUTCOME if exits else "discounted steps"
            label = f"exploitability, exact: lost to a\nbest response ({unit_of})"
            panels.insert(0, Panel(exploitability, label, scale="from 0"))
        return panels

    def legend(self, names: Sequence[str], epsilon: float) -> str:
        """As of `Sides`."""
        return legend_of(names, epsilon)

    def add_episodes(
        self,
        builder: Builder,
        policies: Policies,
        games: Mapping[str, int],
        labels: Mapping[str, str],
    ) -> Replay:
        """As of `Sides`, with values and optimal moves of a duel."""
        contest = GameContest(self.task, "chaser", dict(policies))
        replay = recorded(contest, policies["chaser"], games, "")
        agents = zip(self.task.agent_names, self.by_agent, strict=True)
        replay = replace(replay, players={name: labels[role] for name, role in agents})
        overlays = contest.overlays(policies["chaser"], MOST_OVERLAY_CELLS)
        builder.add(replay, Extras(names=list(games), overlays=overlays))
        return replay
