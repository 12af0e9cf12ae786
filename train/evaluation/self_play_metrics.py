"""Metrics of self-play in mazes: exploitability, matches between all policies, best responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from pursuit.rules.layout import PLAIN
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents import (
    JointNashConv,
    RandomAgent,
    joint_nash_conv,
    solve_joint,
    why_not_optimal,
    work_of,
)
from scripted_agents.exact.limits import (
    MAX_EXACT_WORK,
    MAX_GAME_CELLS,
    MAX_WORK,
    SEARCH_SECONDS,
)
from scripted_agents.exact.long_work import report
from scripted_agents.exact.references import INTERVALS, JOINT, NASH_CONVS, Question, solution_of
from scripted_agents.names import SCRIPTED_NAMES, SEARCHERS
from train.evaluation.departures import OUTCOME_REWARDS
from train.evaluation.exploitability import duel_nash_conv, exploitability, team_exploitability
from train.evaluation.games import order_of, other_role, table_in
from train.evaluation.hidden_contest import best_response_interval
from train.evaluation.matchups import match
from train.evaluation.scores import OUTCOME
from train.evaluation.team_contest import TeamContest, team_results
from train.files import Plain
from train.settings.self_play import OPPOSING_ROLES


def exploited(task: Task, chaser: Policy, evader: Policy, discount: float) -> dict[str, float]:
    """The columns of the exact exploitability in discounted steps; empty if it is not computed.

    In mazes above `MAX_GAME_CELLS` cells only "nash_conv", which does not need the game's value.
    """
    pair = {"chaser": chaser, "evader": evader}
    kind = nash_conv_solver(task, pair)
    if kind == "duel":
        tables = table_in(task, chaser), table_in(task, evader)
        game = (task.mazes[0], *tables, discount, order_of(task))
        if task.mazes[0].num_cells > MAX_GAME_CELLS:
            return {"nash_conv": duel_nash_conv(*game)}
        exploited_by = exploitability(*game)
    elif kind == "none":
        return {}
    elif task.options != PLAIN:
        return {"nash_conv": option_nash_conv(task, pair, discount).nash_conv}
    else:
        exploited_by = team_exploitability(task, chaser, evader, discount)
    return {
        "nash_conv": exploited_by.nash_conv,
        "chaser_exploitability": exploited_by.mean_chaser,
        "evader_exploitability": exploited_by.mean_evader,
        "value": exploited_by.mean_value,
        "game_value": exploited_by.mean_game_value,
    }


def nash_conv_solver(task: Task, pair: Mapping[str, Policy]) -> str:
    """The kind of solver of `exploited`: for small duels and teams against one evader, and for
    small games with exits; else "none"."""
    return solution_of(Question(task, None, pair, MAX_EXACT_WORK), NASH_CONVS).kind


def option_nash_conv(task: Task, pair: Mapping[str, Policy], discount: float) -> JointNashConv:
    """Exact NashConv of a game with options of the rules, with each side as one player.

    In discounted steps (rounds), without time limit. With exits in captures minus escapes within
    `max_steps`, where best responses may depend on time.
    """
    if task.most_exits:
        return joint_nash_conv(
            replace(task, rewards=OUTCOME_REWARDS), pair, task.max_steps, sides=True
        )
    return joint_nash_conv(replace(task, rewards="zero_sum"), pair, None, discount, sides=True)


def format_row(row: Mapping[str, float]) -> list[str]:
    """The metrics of an evaluation as text: exploitability, steps, both sides against A*."""
    parts = []
    if "nash_conv" in row:
        parts.append(f"NashConv {row['nash_conv']:z6.3f}")
    if "chaser_exploitability" in row:
        each = [f"{role} {row[f'{role}_exploitability']:z.3f}" for role in OPPOSING_ROLES]
        parts.append(f"(lost to a best response: {', '.join(each)})")
    parts.append(f"{row['steps']:6.1f} steps")
    if "outcome" in row:
        parts.append(f"{OUTCOME} (chasers want more) {row['outcome']:5.2f}")
    parts += [
        f"{role} vs A* {row[f'{role}_vs_astar']:6.{2 if 'outcome' in row else 1}f}"
        for role in OPPOSING_ROLES
        if f"{role}_vs_astar" in row
    ]
    return parts


def scripted_references(task: Task, role: str | None = None) -> tuple[str, ...]:
    """The scripted agents to compare with; "equilibrium" only if it is solved here.

    For a `role` with a limited view also those with the same view.
    """
    solved = all(why_not_optimal(task, role) is None for role in OPPOSING_ROLES) and (
        task.max_cells <= MAX_GAME_CELLS if task.is_duel else work_of(task) <= MAX_EXACT_WORK
    )
    names = tuple(name for name in SCRIPTED_NAMES if name != "equilibrium" or solved)
    hidden = role is not None and any(
        task.hides_from(agent)
        for agent, own in zip(task.agent_names, task.seat_roles, strict=True)
        if own == role
    )
    return (*names, *SEARCHERS) if hidden else names


def matches(
    task: Task, players: Mapping[str, Mapping[str, Policy]], episodes: int, most: int
) -> list[Plain]:
    """All chasers against all evaders, given as policies by role and name; `most` as in `match`."""
    return [
        {"chaser": c, "evader": e, **match(task, chaser, evader, episodes, most=most).plain()}
        for c, chaser in players["chaser"].items()
        for e, evader in players["evader"].items()
    ]


def exact_best_responses(task: Task, learned: Mapping[str, Policy]) -> dict[str, float]:
    """Mean steps of the exact best response to each learned side, the chasers as one player.

    {"against_evader": steps, ...}.
    """
    steps = {}
    for number, (role, policy) in enumerate(learned.items()):
        report(f"exact best response against the {role}", number / len(learned))
        best = solve_joint(task, other_role(role), {role: policy}, task.max_steps)
        steps[f"against_{role}"] = best.mean_over_starts
    return steps


def team_references(
    task: Task,
    pair: Mapping[str, Policy],
    roles: Sequence[str],
    episodes: int,
    most: int,
    solved: Mapping[str, float],
) -> Plain:
    """ "team" of the results: by role the `team_results` of a team against the other side; {} if
    there is no team.

    Args:
        task: the game.
        pair: the policies by role.
        roles: that learn; those with one agent are no teams.
        episodes: of scores that are not exact.
        most: as `GameContest.most_work`.
        solved: best responses, if they are known (`exact_best_responses`).
    """
    found, roles = {}, [role for role in roles if task.count(role) > 1]
    for number, role in enumerate(roles):
        report(f"the team of {role}s and its members", number / len(roles))
        other = other_role(role)
        contest = TeamContest(task, role, {other: pair[other]}, episodes, most_work=most)
        fair = {**contest.limited, "random": RandomAgent()} if contest.is_limited else {}
        scores = [contest.score(name, policy) for name, policy in fair.items()]
        learned = contest.score("learned, sampled", pair[role])
        best = solved.get(f"against_{other}")
        found[role] = team_results(contest, pair[role], learned, [*scores, learned], best)
    return {"team": found} if found else {}


def limited_best_responses(
    task: Task, pair: Mapping[str, Policy], seconds: float = SEARCH_SECONDS
) -> Plain:
    """Proven intervals of best responses with limited views, in discounted steps.

    A best response has the view of its role; its opponent must be a policy without memory. The
    search for each interval takes at most so many seconds.

    Returns:
        "against_chaser" and "against_evader", each (lower, upper), where these are known; with both
        also "nash_conv".
    """
    intervals: Plain = {}
    for role, policy in pair.items():
        asked = Question(task, other_role(role), {role: policy})
        if solution_of(asked, INTERVALS).kind != "none":
            how = table_in(task, policy), seconds
            intervals[f"against_{role}"] = best_response_interval(task, other_role(role), *how)
    if len(intervals) == len(OPPOSING_ROLES):  # an evader's best response is against the chaser
        (low, high), (least, most) = intervals["against_chaser"], intervals["against_evader"]
        intervals["nash_conv"] = max(low - most, 0.0), high - least
    return intervals


def whole_game(
    task: Task, pair: Mapping[str, Policy], discount: float, most: int = MAX_WORK
) -> Plain:
    """Exact NashConv of a game of teams or with goals, in returns, with each side as one player.

    With exits that of `option_nash_conv`. Otherwise without time limit: {"nash_conv": ...,
    "returns": by role, "gains": by role}. Empty if the game is larger than `most` (`work_of`),
    partially observable, or has a user-defined reward function.
    """
    if JOINT.why_not(Question(task, None, pair, most)) is not None:
        return {}
    if task.most_exits and not task.num_goals:
        game = option_nash_conv(task, pair, discount)
    else:
        game = joint_nash_conv(task, pair, None, discount, sides=True)
    return {"nash_conv": game.nash_conv, "returns": game.returns, "gains": game.gains}
