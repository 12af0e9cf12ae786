"""What a game by hand brought, beside the optimum and an agent from the same start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NOT_KNOWN = "not known"


@dataclass(frozen=True)
class Outcome:
    """What one game brought.

    Attributes:
        won: as in evaluations: the chasers caught all, the evader lived to the last step, all goals
            were collected (by a runner among rivals more than by each other agent).
        steps: that the person played.
        reward: what these steps paid.
        optimal_steps: the optimum from the same start: steps of the best response in expectation,
            or of a shortest tour; None where it is not known.
        expected: whether that is an expectation, which luck may beat.
        agent: who played the same start in the person's seat.
        agent_steps, agent_won, agent_goals: what came of it, in one game with the same luck of the
            others.
        collected: goals that each agent got, the person's first; empty where nobody competes.
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
        """The optimum in words."""
        if self.optimal_steps is None:
            return NOT_KNOWN
        # Two digits after the point, or as many as there are.
        text = f"{self.optimal_steps:.2f}".rstrip("0").rstrip(".")
        return f"{text} steps" + (" in expectation" if self.expected else "")

    def rows(self) -> list[tuple[str, str]]:
        """Who, and what they did: the person, the optimum, the agent, and goals where many compete.

        Among several who collect, nobody is said to win: the goals tell.
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
        width = 2 + max(len(who) for who, _ in self.rows())
        return [f"{who:<{width}}{what}" for who, what in self.rows()]


def total_line(outcomes: Sequence[Outcome]) -> str:
    """All games so far in one line; nothing before the second."""
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
