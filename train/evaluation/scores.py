"""What a run knows of what it is judged by: contests, and the scores that they give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy

BEST_PAID = "optimal return"
"""The name of whoever is paid most, where that is known."""
FULL_SIGHT = ", full sight"
"""Behind the name of an optimum of who sees everything: a bound for an agent that does not."""


@dataclass(frozen=True)
class Score:
    """What one policy achieves.

    Attributes:
        name: of the policy.
        mean_steps: mean episode length; an episode that runs out of time counts with all its steps.
        ci95: half width of the 95 % confidence interval of the mean; 0 where it is exact.
        success_rate: share of episodes won: the chasers caught all, the evader lived to the last
            step, all goals were collected.
        episodes: played for this score (or, where exact, for the success rate alone).
        exact: whether `mean_steps` is an exact mean over all starts.
        discounted_steps, discounted_ci95: the same of discounted steps, for agents with limited
            sight, whose optimum is certified in these; None elsewhere.
        solved_gap: achieved / optimal - 1 over the starts that were solved alone, of one runner:
            what is left of the gap without those that ran out of time. None elsewhere.
        mean_return: the mean of what the agent is paid in an episode; None where none was played.
    """

    name: str
    mean_steps: float
    ci95: float
    success_rate: float
    episodes: int
    exact: bool
    discounted_steps: float | None = None
    discounted_ci95: float | None = None
    solved_gap: float | None = None
    mean_return: float | None = None


def optimality_gap(achieved: Score, optimum: Score | None) -> float | None:
    """Achieved / optimal - 1 in steps, on the same starts; negative for evaders that fall short."""
    return None if optimum is None else achieved.mean_steps / optimum.mean_steps - 1.0


def return_regret(achieved: Score, best: Score | None) -> float | None:
    """By how much less an agent is paid in an episode than the best one, on the same starts."""
    if best is None or best.mean_return is None or achieved.mean_return is None:
        return None
    return best.mean_return - achieved.mean_return


STEPS, PAID, DISCOUNTED = "steps", "paid", "discounted steps"


@dataclass(frozen=True)
class Reference:
    """What a learned policy is held against.

    Attributes:
        kind: "exact"; "certified", the far end of what is proven of an optimum; "bound", that which
            nobody can pass, such as the optimum of an agent that sees everything; "best known", the
            best of the scripted agents, random play among them.
        name: of the score that it is.
        unit: `STEPS`, `DISCOUNTED` or `PAID`.
        value: in that unit.
        distance: of steps the gap to it, achieved / reference - 1; of payments what is missing.
    """

    kind: str
    name: str
    unit: str
    value: float
    distance: float

    def line(self) -> str:
        """In words."""
        paid = self.unit == PAID
        less = "less" if self.distance >= 0 else "more"
        far = f"{abs(self.distance):.3f} {less}" if paid else f"gap {100 * self.distance:+.2f} %"
        kinds = {"bound": "a bound", "best known": "best known, not proven"}
        what = kinds.get(self.kind, self.kind)
        return f"reference: {self.name} ({what}), {self.value:.3f} {self.unit}; learned: {far}"


def reference_of(
    scores: Sequence[Score],
    learned: Score,
    paid: bool = False,
    less_is_better: bool = True,
    fair: Sequence[str] | None = None,
) -> Reference | None:
    """The strongest reference among these scores: exact, a bound, or the best known.

    Args:
        scores: of the references and of what was learned.
        learned: what is held against it.
        paid: whether a policy is judged by what it is paid.
        less_is_better: whether few steps are good.
        fair: names of the scripted agents that see no more than the learner, for one of limited
            sight: the others are no reference. None for all of them.

    Returns:
        None where nobody but the learner has been scored.
    """
    goal = BEST_PAID if paid else "optimal"
    by_name = {score.name: score for score in scores}
    for kind, name in (("exact", goal), ("bound", goal + FULL_SIGHT)):
        if name in by_name:
            return _held_against(kind, by_name[name], learned, paid)
    known = [
        score
        for score in scores
        if (fair is None or score.name in fair)
        and not score.name.startswith("learned")
        and (not paid or score.mean_return is not None)
    ]
    if not known:
        return None
    worth: Any = (lambda s: -s.mean_return) if paid else (lambda s: s.mean_steps)
    best = min(known, key=worth) if paid or less_is_better else max(known, key=worth)
    return _held_against("best known", best, learned, paid)


def _held_against(kind: str, best: Score, learned: Score, paid: bool) -> Reference:
    value = best.mean_return if paid else best.mean_steps
    distance = return_regret(learned, best) if paid else optimality_gap(learned, best)
    unit = PAID if paid else STEPS
    return Reference(kind, best.name, unit, float(value or 0.0), float(distance or 0.0))


def told(policy: Policy) -> str:
    """A policy in words: its own, or else the name of its class."""
    plain = type(policy).__repr__ is object.__repr__
    return type(policy).__name__ if plain else repr(policy)


class Contest(Protocol):
    """What a run is judged by.

    Attributes:
        less_is_better: whether few steps are good.
    """

    @property
    def less_is_better(self) -> bool: ...  # noqa: D102 -- see the class

    def describe(self) -> dict[str, Any]:
        """What is played, by whom and where, as plain values: "task", "role", "maze"."""

    def line(self) -> str:
        """The same in one line, with whoever else plays."""

    def score(self, name: str, policy: Any) -> Score:
        """How well a policy does."""

    def optimal(self) -> Score | None:
        """The exact optimum; None where it is not known."""

    def baselines(self) -> list[Score]:
        """The references: random, scripted and, where it is known, optimal."""

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """What `learned` is held against, of these scores; None where there is nothing."""

    def scenes(self, policy: Any, episodes: int = 3) -> list[Any]:
        """What a person sees of some episodes, one after the other, for `save_animation`."""

    def game(self, policy: Any, number: int) -> tuple[Any, Iterator[None]]:
        """The episode of that number: a simulator at its start, and what steps it to its end."""

    def lengths(self, policy: Any) -> NDArray[np.float64]:
        """[episodes], how long each takes this policy; expected ones where they are known."""

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """[episodes], the optimum of each start; None where it is not known."""
