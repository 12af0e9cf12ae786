"""The result of a game played by the user, compared with the optimum and an agent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NOT_KNOWN = "not known"


@dataclass(frozen=True)
class GameResult:
    """The result of one game.

    Attributes:
        won: as in evaluations: all evaders caught, the evader not caught, all goals collected (in a
            race, more goals than each other runner).
        steps: number of steps of the user.
        reward: return of the user.
        optimal_steps: the optimum from the same start: expected steps of the best response, or the
            length of a shortest tour; None if it is not known.
        expected: whether `optimal_steps` is an expectation, so that single games can be shorter.
        agent: name of the policy that played the same start in place of the user.
        agent_steps, agent_won, agent_goals: its result, with the same random numbers for the other
            agents.
        collected: goals of each agent, the user first; empty if no other agent collects goals.
    """

    won: bool
    steps: int
    reward: float
    optimal_steps: float | None
    expected: bool
    agent: str
    agent_steps: int
    agent_won: bool
    agent_goals: int = 0
    collected: tuple[tuple[str, int], ...] = ()

    @property
    def optimum(self) -> str:
        """The optimum as text."""
        if self.optimal_steps is None:
            return NOT_KNOWN
        # At most two decimals.
        text = f"{self.optimal_steps:.2f}".rstrip("0").rstrip(".")
        return f"{text} steps" + (" in expectation" if self.expected else "")

    def rows(self) -> list[tuple[str, str]]:
        """Names and results: the user, the optimum, the agent, and the goals of all agents.

        If several agents collect goals, goals are shown in place of won or lost.
        """
        own, other = (", won" if won else ", lost" for won in (self.won, self.agent_won))
        if len(self.collected) > 1:
            own, other = f", goals: {self.collected[0][1]}", f", goals: {self.agent_goals}"
        rows = [
            ("you", f"{self.steps} steps{own}"),
            ("optimum", self.optimum),
            (self.agent, f"{self.agent_steps} steps{other}"),
        ]
        if self.collected:
            rows.append(("goals", ", ".join(f"{name} {n}" for name, n in self.collected)))
        return rows

    def lines(self) -> list[str]:
        """The rows as text."""
        width = 2 + max(len(name) for name, _ in self.rows())
        return [f"{name:<{width}}{result}" for name, result in self.rows()]


def total_line(outcomes: Sequence[GameResult]) -> str:
    """All games so far in one line; empty for fewer than two games."""
    if len(outcomes) < 2:
        return ""
    count = len(outcomes)
    parts = [f"you {sum(o.steps for o in outcomes) / count:.2f}"]
    optima = [o.optimal_steps for o in outcomes if o.optimal_steps is not None]
    if len(optima) == count:
        parts.append(f"optimum {sum(optima) / count:.2f}")
    parts.append(f"{outcomes[0].agent} {sum(o.agent_steps for o in outcomes) / count:.2f}")
    won = sum(o.won for o in outcomes)
    return f"{count} games, {won} won; mean steps: {', '.join(parts)}"
