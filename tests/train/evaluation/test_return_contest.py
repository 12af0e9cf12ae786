"""Evaluation in returns of games of which no more is known than their batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from claims import FREE, AnyFree, Claims, ClaimsBatch

from pursuit.replays.viewer.data import Builder
from pursuit.validation import Missing
from scripted_agents.agents.random_policy import RandomPolicy
from train.evaluation.return_contest import ReturnContest
from train.evaluation.scores import BY_RETURN


class Mirror:
    """Names the same square in all games."""

    def __init__(self, square: int) -> None:
        self.square = square

    def act(self, view: Any) -> Any:
        return np.full(view.num_games, self.square, dtype=np.int32)


class ByHand:
    """As of `ReturnSolver`: the player that names the square of nobody else gets it if it is free,
    with probability (5 / 6) ** 3."""

    def why_not(self, task: Any, policies: Any) -> str | None:
        return None if all(isinstance(own, Mirror) for own in policies.values()) else "no mirrors"

    def returns(self, task: Any, policies: Any) -> Any:
        squares = [policies[name].square for name in task.agent_names]
        return np.array([(5 / 6) ** 3 * (squares.count(own) == 1) for own in squares])

    def respond(self, task: Any, agent: str, policies: Any) -> tuple[float, Any]:
        return (5 / 6) ** 3, Mirror(2)


OTHERS = {"green": Mirror(0), "blue": Mirror(1)}
TASK = Claims(squares=6, max_steps=1)


def free(batch: Any, agents: slice) -> Any:
    return (batch.owner == FREE)[:, None]


def test_scores_are_means_of_episodes_with_intervals_of_returns() -> None:
    contest = ReturnContest(TASK, "red", OTHERS, ClaimsBatch, 4000)
    score = contest.score("learned", Mirror(2))
    assert score.mean_return == pytest.approx((5 / 6) ** 3, abs=2 * score.value_ci95)  # type: ignore[operator]
    assert not score.exact and score.mean_steps == 1.0 and score.ci95 == 0.0
    p = score.mean_return
    assert score.value_ci95 == pytest.approx(1.96 * (p * (1 - p) / 4000) ** 0.5, rel=1e-3)  # type: ignore[operator]
    assert contest.score("learned", Mirror(2)) == score  # the same starts
    assert contest.measure is BY_RETURN
    assert contest.describe() == {
        **{"task": "claims", "role": "red", "maze": None, "game": "claims"}
    }
    assert contest.line() == "claims: red, with green Mirror, blue Mirror, at most 1 steps"


def test_the_random_policy_draws_all_legal_actions_alike() -> None:
    batch, chosen = ClaimsBatch(Claims(squares=6), 6000, 3, auto_restart=False), []
    for allowed in (None, free):
        actions = RandomPolicy(6, allowed).act(batch.view("green"))
        assert actions.dtype == np.int32
        chosen.append(actions)
    assert np.bincount(chosen[0], minlength=6) == pytest.approx(1000, abs=150)
    legal = batch.owner == FREE
    assert legal[np.arange(6000), chosen[1]].all()
    expected = (legal / legal.sum(axis=1, keepdims=True)).sum(axis=0)
    assert np.bincount(chosen[1], minlength=6) == pytest.approx(expected, abs=150)
    batch.owner[:] = 0
    assert not RandomPolicy(6, free).act(batch.view("green")).any()


def test_references_are_the_random_policy_and_what_a_solver_says() -> None:
    random: Any = RandomPolicy(6, free)
    contest = ReturnContest(TASK, "red", OTHERS, ClaimsBatch, 500, solver=ByHand(), random=random)
    low, best = contest.baselines()
    assert (low.name, low.exact) == ("random", False)
    assert (best.name, best.exact) == ("optimal return", True)
    assert (best.mean_return, best.value_ci95) == ((5 / 6) ** 3, 0.0)
    found = contest.reference([low, best], contest.score("learned", Mirror(2)))
    assert found is not None and found.kind == "exact"
    assert contest.best_policy().square == 2 and contest.scripted() is random
    assert contest.optimal_policy().square == 2  # it has no ties, as the solver gives one policy
    unsolved = ReturnContest(
        TASK, "red", {**OTHERS, "blue": AnyFree()}, ClaimsBatch, 9, solver=ByHand()
    )
    assert unsolved.baselines() == [] and unsolved.why_no_optimum == "no mirrors"
    with pytest.raises(ValueError, match="optimal policy: no mirrors; leave out --optimal"):
        unsolved.best_policy()
    with pytest.raises(ValueError, match="no optimal policy to imitate: no mirrors; give"):
        unsolved.optimal_policy()
    lone = ReturnContest(TASK, "red", OTHERS, ClaimsBatch, 9)
    assert lone.exact_reference.reason == "this game has no solver"
    with pytest.raises(ValueError, match="only learned policies"):
        lone.scripted()
    assert isinstance(lone.solver, Missing)


@dataclass(frozen=True)
class Sides(Claims):
    """Red and green are of one role."""

    seat_roles = ("warm", "warm", "blue")


def test_one_policy_plays_all_agents_of_a_role_for_the_sum_of_their_returns() -> None:
    contest = ReturnContest(
        Sides(6, 2), "warm", {"blue": Mirror(5)}, ClaimsBatch, 200, solver=ByHand()
    )
    assert contest.names == ("red", "green")
    assert contest.score("learned", Mirror(5)).mean_return == 0.0  # all want the same square
    assert contest.exact_reference.reason == ""  # the solver takes roles
    assert contest.players("ppo") == {"blue": "Mirror", "red": "ppo", "green": "ppo"}


def test_episodes_are_shown_as_texts() -> None:
    contest = ReturnContest(Claims(6, 3), "red", OTHERS, ClaimsBatch, 9)
    scenes: Any = contest.scenes(Mirror(2), 1)
    assert "owner: " in scenes[0].text() and "step 0 / 3" in scenes[0].text()
    builder = Builder()
    assert contest.add_episodes(builder, Mirror(2), {"one": 0, "two": 1}, "learned") is None
    (world,), items = builder.worlds, builder.items
    assert [item["name"] for item in items] == ["one", "two"]
    for item in items:
        assert len(item["states"]) == item["length"] + 1
        assert np.shape(item["rewards"]) == (3, item["length"])
        won = np.sum(item["rewards"][0])
        first, end = (world["states"][item["states"][at]]["drawing"] for at in (0, -1))
        assert end.startswith("owner: [")
        assert end.count("0") - first.count("0") == won  # red is seat 0
