"""Evaluation of a whole team, beside its best response as one player and those of its members."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from pursuit.simulator.policy import Policy
from pursuit.validation import check
from scripted_agents import JointResponse, evaluate_joint, solve_joint
from scripted_agents.exact.joint.opponents import why_no_distribution
from scripted_agents.exact.limits import work_of
from scripted_agents.exact.long_work import OutOfTime, why_no_time
from scripted_agents.exact.references import Solution, reference_of
from train.evaluation.contest import GameContest
from train.evaluation.matchups import Matchup, exact_joint_match
from train.evaluation.scores import FULL_VIEW, OUTCOME, Measure, Score
from train.files import Plain


@dataclass(frozen=True)
class TeamContest(GameContest):
    """All agents of a role as a team, against fixed policies of the other roles; a `Contest`.

    `agent` is the role, and the evaluated policy plays all its agents. The measure is that of one
    agent of the role: the steps until the last capture, where a time-out counts `max_steps`; with
    exits captures minus escapes; in a heist the sum of the returns. The optimum is the best
    response of the team as one player with the full state. `members` gives the best response of
    each member, with the others fixed, in the same measure: a team with a gap whose members have
    none fails to coordinate, as no member alone can do better.

    Raises:
        ValueError: no such role, several mazes, or several runners.
    """

    def __post_init__(self) -> None:
        task, role = self.task, self.agent
        roles = ", ".join(dict.fromkeys(task.seat_roles))
        check(role in task.seat_roles, f"agent={role!r}; a team is a role: give one of {roles}")
        check(
            role != "runner" or task.num_runners == 1,
            f"{task.num_runners} runners compete for the same goals, so they have no result as a "
            "team; evaluate one of them, such as runner_0",
        )
        check(
            len(task.mazes) == 1,
            f"a team is evaluated in one maze, but the task has {len(task.mazes)}; give one of "
            "them (or to `pursuit evaluate` --teammates scripted, for one member of a team)",
        )

    @property
    def seats(self) -> tuple[int, ...]:
        """As `MazeContest`: those of all members."""
        return tuple(s for s, role in enumerate(self.task.seat_roles) if role == self.agent)

    @property
    def player(self) -> str:
        """As `MazeContest`."""
        return f"team of {len(self.seats)} {self.agent}s"

    def with_policy(self, policy: Policy) -> dict[str, Policy]:
        """As `MazeContest`."""
        others = {n: own for n, own in self.opponents.items() if n.split("_")[0] != self.agent}
        return {**others, self.agent: policy}

    @cached_property
    def exact_reference(self) -> Solution:
        """As `Contest`, for the team as one player."""
        return reference_of(self.task, self.agent, self.opponents, self.most_work, team=True)

    # -- exact solutions -----------------------------------------------------------------------

    def why_not_solved(self, policy: Policy) -> str | None:
        """The reason why the play of a policy, and best responses of members to it, are not known
        exactly; None if they are."""
        reason = self.full.exact_reference.reason
        seats = range(self.task.num_agents)
        return reason or why_no_distribution(self.task, seats, self.with_policy(policy))

    def exact_match(self, policy: Policy) -> Matchup | None:
        """As `GameContest`."""
        task = self.task
        if task.is_duel:
            return super().exact_match(policy)
        several = task.most_exits and task.num_evaders > 1  # the share of wins is not known
        if task.num_goals or several or self.why_not_solved(policy) is not None:
            return None
        return exact_joint_match(task, self.with_policy(policy))

    def value_of(self, policy: Policy) -> float:
        """The exact result of a policy in the measure, the mean over all starts.

        Raises:
            ValueError: it is not known (`why_not_solved`).
        """
        task, played = self.task, self.with_policy(policy)
        if self.measure.name == "return":
            found = evaluate_joint(task, played, task.max_steps, agents=self.agent)
            return sum(found.returns.values())
        return exact_joint_match(task, played).shown

    @cached_property
    def best(self) -> float | None:
        """The result of the best team response in the measure, the mean over all starts; None if it
        is not known, and of one against one."""
        found = self.full.best_in(self.measure)
        if not isinstance(found, JointResponse):
            return None
        return self._in_measure(found.mean_over_starts)

    def _in_measure(self, mean: float) -> float:
        """A mean of the objective in the measure: evaders minimise captures minus escapes."""
        negative = self.measure.name == "outcome" and self.role == "evader"
        return -mean if negative else mean

    def members(self, policy: Policy) -> dict[str, float]:
        """By member the result of the team in the measure, the mean over all starts, if this member
        plays its best response with the full state and the others play the policy.

        Raises:
            ValueError: it is not known (`why_not_solved`).
        """
        task, played = self.task, self.with_policy(policy)
        task = self.by_outcome if self.measure.name == "outcome" else task
        found = {}
        for name in (task.agent_names[seat] for seat in self.seats):
            how: Plain = {"objective": "steps" if self.measure.by_steps else "return"}
            best = solve_joint(task, name, played, task.max_steps, counted=self.agent, **how)
            found[name] = self._in_measure(best.mean_over_starts)
        return found

    def further(self, policy: Policy, score: Score, scores: Sequence[Score]) -> Plain:
        """As `Contest`: "team"."""
        return {"team": team_results(self, policy, score, scores)}


# -- results ---------------------------------------------------------------------------------------


def team_results(
    contest: TeamContest,
    policy: Policy,
    score: Score,
    scores: Sequence[Score] = (),
    best: float | None = None,
) -> Plain:
    """ "team" of the results: plain values, which `describe_team` prints.

    Args:
        contest: the evaluation.
        policy: of the team.
        score: its score.
        scores: of all policies; those with the same view may be the other end of the interval of a
            limited view.
        best: the best team response, if it is already known (`TeamContest.best`).

    Returns:
        "role", "size", "measure"; the result under the name of the measure, "exact" and "ci95";
        "best_response", of the team, and "gap" (`Measure.gap`), or None and the "reason";
        "full_view", whether the team has a limited view, so that best responses are bounds;
        "members": by name the same, or {} and "members_reason"; with a limited view "interval", of
        the optimum: "bound" (or None), and the result that a policy with this view "achieved", its
        name and "exact".
    """
    measure, why = contest.measure, contest.why_not_solved(policy)
    best = contest.best if best is None else best
    value, exact = measure.of(score) or 0.0, score.exact
    if why is None and not exact:
        value, exact = contest.value_of(policy), True
    members = {}
    try:
        members = contest.members(policy) if why is None else {}
    except OutOfTime:  # what is solved already is kept
        if (why := why_no_time(work_of(contest.task))) is None:
            raise
    content: Plain = {
        "role": contest.role,
        "size": len(contest.seats),
        "measure": measure.name,
        measure.name: value,
        "exact": exact,
        "ci95": 0.0 if exact else score.ci95 if measure.by_steps else score.value_ci95,
        **_beside(measure, value, best),
        "reason": contest.full.exact_reference.reason if best is None else "",
        "full_view": contest.is_limited,
        "members": {name: _beside(measure, value, own) for name, own in members.items()},
        "members_reason": why or "",
    }
    if contest.is_limited:
        names = (*contest.limited, "random")
        fair = [one for one in scores if one.name in names or one.name.startswith("learned")]
        known = measure.best([*fair, score]) or score
        at = {"achieved": measure.of(known), "exact": known.exact}
        if known.name == score.name:
            at = {"achieved": value, "exact": exact}
        content["interval"] = {"bound": best, **at, "name": known.name}
    return content


def _beside(measure: Measure, value: float, best: float | None) -> Plain:
    gap = None if best is None else measure.gap(value, best)
    return {"best_response": best, "gap": gap}


def describe_team(found: Plain) -> list[str]:
    """The results of `team_results` as lines of text."""
    name = found["measure"]
    unit = OUTCOME if name == "outcome" else name

    def gap(of: Plain) -> str:
        by_steps = f"gap {100 * of['gap']:+.2f} %"
        return by_steps if name == "steps" else f"{of['gap']:z.3f} from it"

    full = FULL_VIEW if found["full_view"] else ""
    how = "exact" if found["exact"] else "sampled"
    how = f"± {found['ci95']:.3f}" if not found["exact"] and found["ci95"] is not None else how
    lines = [f"team of {found['size']} {found['role']}s: {found[name]:.3f} {unit} ({how})"]
    interval, of_known, known = found.get("interval"), "", 0.0
    if interval is not None:
        known = interval["achieved"]
        of_known = f"{interval['name']}, {'exact' if interval['exact'] else 'sampled'}"
    if found["best_response"] is None:
        lines[0] += f"; no exact best team response: {found['reason']}"
        if interval is not None:
            lines.append(f"best known with these views: {known:.3f} {unit} ({of_known})")
        return lines
    lines[0] += f"; best team response{full} {found['best_response']:.3f}: {gap(found)}"
    each = ", ".join(
        f"{member} {own['best_response']:.3f} ({gap(own)})"
        for member, own in found["members"].items()
    )
    why = found["members_reason"]
    lines.append(
        f"no exact best responses of single members: {why}"
        if why
        else f"best response of one member{full}, the others fixed: {each}"
    )
    if interval is not None:
        ends = [(interval["bound"], "best team response, full view; proven"), (known, of_known)]
        (low, of_low), (high, of_high) = sorted(ends)
        lines.append(
            f"the optimum of a team with these views lies between {low:.3f} ({of_low}) and "
            f"{high:.3f} {unit} ({of_high})"
        )
    return lines
