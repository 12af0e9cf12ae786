"""A score is exact only where the policies are functions of the cells, whatever says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pursuit
from pursuit.observations.observations import Encoder
from pursuit.simulator.policy import GameView, TabularPolicy, tells_its_play
from pursuit.tasks.task import make_task
from pursuit.tasks.visibility import Limit
from scripted_agents import AStarChaser, AStarEvader, RandomAgent, TablePolicy
from scripted_agents.exact.references import is_known, is_table_in, reference_of
from train.evaluation.contest import GameContest
from train.evaluation.games import usual_episodes
from train.evaluation.matchups import match
from train.evaluation.self_play_metrics import exploited
from train.networks.policy import JointPolicy, LearnedPolicy, NetworkPolicy, sees_cells_only
from train.runs.parts import parts_of, settings_of
from train.runs.single import SingleAgent

DUEL = {"maze": "3x3", "max_steps": 20}


def learned(**flat: Any) -> SingleAgent:
    """A new run of PPO."""
    given: dict[str, Any] = {"frames": 20_000, "num_games": 32, "minibatch_size": 64, **flat}
    return SingleAgent(parts_of(settings_of(**given)), "greedy")


def revealing(every: int) -> Any:
    """`Encoder.encode` of a rule by which other agents are seen in every so many steps only."""
    plain = Encoder.encode

    def encode(self: Encoder, games: Any, *rest: Any) -> Any:
        seen, position = plain(self, games, *rest), games.position.copy()
        position[:, 1:] = position[:, :1]
        alone = plain(self, games._replace(position=position), *rest)
        shown = (games.steps % every == 0).reshape(-1, *(1,) * (seen.ndim - 1))
        return np.where(shown, seen, alone)

    return encode


@pytest.fixture
def revealed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The rule for all encodings, as if it were built in."""
    sees_cells_only.cache_clear()
    yield lambda: (
        monkeypatch.setattr(Encoder, "encode", revealing(3)),
        sees_cells_only.cache_clear(),
    )
    sees_cells_only.cache_clear()


@pytest.mark.parametrize("observation", ["index", "planes", "window:1+id"])
def test_a_built_in_observation_that_depends_on_the_step_has_sampled_scores(
    observation: str, revealed: Any
) -> None:
    before = learned(**DUEL, observation=observation)
    policy, contest = before.policy, before.contest
    assert isinstance(contest, GameContest) and isinstance(policy, LearnedPolicy)
    assert contest.score("learned", policy).exact and is_known(contest.task, policy)
    revealed()
    task, opponent = contest.task, contest.opponents["evader"]
    # A policy from before the rule: its table would be that of a step in which all are seen.
    assert not is_table_in(task, policy) and not is_known(task, policy)
    score = contest.score("learned", policy)
    assert not score.exact and score.ci95 > 0.0
    assert match(task, policy, opponent, 50).games == 50
    assert exploited(task, policy, opponent, 0.95) == {}
    found = reference_of(task, "evader", {"chaser": policy})
    assert found.kind == "none" and "no small" not in found.reason
    assert "depends on the step" in found.reason
    # And one that is trained by it.
    after = learned(**DUEL, observation=observation)
    assert type(after.policy) is NetworkPolicy and not isinstance(after.policy, TabularPolicy)
    assert not after.contest.score("learned", after.policy).exact
    for each in (before, after):
        each.close()


def test_a_team_as_one_player_has_no_distribution_then(revealed: Any) -> None:
    run = learned(**DUEL, num_chasers=2)
    joint = JointPolicy(run.policy)
    revealed()
    task = run.contest.task
    found = reference_of(task, "evader", {"chaser": joint})
    assert found.kind == "none" and "depends on the step" in found.reason
    assert not run.contest.score("learned", run.policy).exact
    run.close()


class Sleepy(AStarEvader):
    """Moves in every other step: inherits the table of an agent that always moves."""

    def act(self, view: GameView) -> Any:
        return np.where(view.steps % 2 == 0, super().act(view), 0).astype(np.int32)


class Remembers(AStarEvader):
    """Has a memory, and the table of an agent without."""

    memory: Any = None

    def begin(self, view: GameView, games: Any) -> None:
        pass


class Cautious(AStarEvader):
    """Another agent with another table."""

    def act(self, view: GameView) -> Any:
        return RandomAgent().act(view)

    def action_probabilities(self, maze: Any, stay_action: bool = False) -> Any:
        return RandomAgent().action_probabilities(maze, stay_action)


class Wrapped:
    """Another agent's methods but for its own `act`."""

    def __init__(self, policy: Any) -> None:
        self.policy = policy

    def __getattr__(self, name: str) -> Any:
        return getattr(self.policy, name)

    def act(self, view: GameView) -> Any:
        return self.policy.act(view)


@pytest.mark.parametrize("policy", [Sleepy(), Remembers(), Wrapped(AStarEvader())])
def test_inherited_tables_tell_nothing_of_an_own_act_or_memory(policy: Any) -> None:
    duel, team = make_task("chase", **DUEL), make_task("chase", **DUEL, num_chasers=2)
    assert isinstance(policy, TabularPolicy) and not is_table_in(duel, policy)
    for task in (duel, team):
        contest = GameContest(task, "chaser", {"chaser": AStarChaser(), "evader": policy}, 50)
        assert contest.exact_reference.kind == "none"
        assert "memory or no distribution" in contest.exact_reference.reason
        assert contest.optimal() is None and not contest.score("A*", AStarChaser()).exact
        assert match(task, AStarChaser(), policy, 20).games == 20


def test_what_tells_its_play() -> None:
    task = make_task("chase", **DUEL)
    table = TablePolicy(task.mazes[0], RandomAgent().action_probabilities(task.mazes[0]))
    for policy in (AStarChaser(), RandomAgent(), Cautious(), table):
        assert is_table_in(task, policy)
    assert tells_its_play(AStarChaser(), "distribution")
    assert not tells_its_play(Cautious(), "distribution")
    table.is_table = lambda task: False  # type: ignore[attr-defined]
    assert not is_table_in(task, table)


def test_all_limits_of_views_are_known_to_the_proven_intervals() -> None:
    """`bounds_in`, the beliefs and `visibility_of` take these; one more is taken up, or refused by
    `_why_no_bounds`, before it is added here."""
    assert Limit._fields == ("view_radius", "line_of_sight", "unknown_maze")


@pytest.mark.parametrize(
    ("task", "episodes"),
    [
        ({"num_chasers": 1, "num_evaders": 1, "max_steps": 200}, 1000),
        ({"num_chasers": 4, "num_evaders": 4, "max_steps": 250}, 1000),
        ({"num_chasers": 4, "num_evaders": 4, "max_steps": 500}, 500),
        ({"num_chasers": 8, "num_evaders": 30, "max_steps": 500}, 105),
        ({"num_chasers": 25, "num_evaders": 50, "max_steps": 500}, 100),
    ],
)
def test_long_games_of_many_agents_are_evaluated_by_fewer_episodes(
    task: dict[str, int], episodes: int
) -> None:
    assert usual_episodes(pursuit.Task("15x15-open", **task), 1000) == episodes


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_steps_lost_by_start_cell_add_up_to_the_gap(role: str) -> None:
    policies = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.3)}
    own = policies.pop(role)
    contest = GameContest(make_task("chase", maze="4x4", max_steps=30), f"{role}_0", policies, 10)
    lost, best = contest.lost_by_start(own), contest.optimal()
    assert lost is not None and best is not None and lost.min() >= 0.0
    gap = abs(contest.score("", own).mean_steps - best.mean_steps)
    assert lost.mean() == pytest.approx(gap)  # each cell is a start equally often
    limited = make_task("chase", maze="4x4", max_steps=30, view_radius=2)
    assert GameContest(limited, f"{role}_0", policies, 10).lost_by_start(own) is None


def test_steps_lost_by_start_cell_of_a_runner_are_those_of_its_episodes() -> None:
    task = make_task("maze", maze="4x4", num_goals=2, max_steps=50)
    contest = GameContest(task, "runner_0", {}, 40)
    found, lengths, tours = (
        contest.lost_by_start(RandomAgent()),
        *contest.play(RandomAgent())[:1],
        contest.tours,
    )
    assert found is not None and tours is not None
    cells = contest.starts().positions[:, 0]
    for cell in range(16):
        here = cells == cell
        expected = (lengths - tours)[here].mean() if here.any() else np.nan
        assert found[cell] == pytest.approx(expected, nan_ok=True)
    race = make_task("race", maze="3x3", num_runners=2, num_goals=1)
    assert (
        GameContest(race, "runner_0", {"runner": RandomAgent()}, 4).lost_by_start(RandomAgent())
        is None
    )
