"""Teams are measured as one player: against value iteration written from the rules."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from string import ascii_lowercase
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, AStarEvader, RandomAgent, evaluate_joint, solve_joint
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from train.evaluation.contest import GameContest
from train.evaluation.scores import BY_STEPS
from train.evaluation.team_contest import TeamContest, describe_team, team_results

HORIZON = 7


class Drawn:
    """A random distribution of every agent in every state: free evaders, and cells of the rest."""

    def __init__(self, task: Task, seed: int) -> None:
        self.task = task
        shape = (task.num_agents, task.max_cells**task.num_agents, 2**task.num_evaders)
        random = np.random.default_rng(seed)
        self.rows = random.dirichlet(np.ones(task.num_actions), shape)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        first, cells = task.num_chasers, task.max_cells
        place = (games.position * games.active) @ cells ** np.arange(task.num_agents)[::-1]
        free = games.active[:, first:] @ 2 ** np.arange(task.num_evaders)[::-1]
        return np.asarray(self.rows[seat, place, free])

    def act(self, view: GameView) -> NDArray[np.int32]:
        rows = self.distribution(view.task, view.games, view.seat).cumsum(axis=1)
        return (view.uniform()[:, None] > rows[:, :-1]).sum(axis=1).astype(np.int32)


class Plain:
    """The game by its rules: all states, and where every joint action leads."""

    def __init__(self, task: Task) -> None:
        maze, chasers, agents = task.mazes[0], task.num_chasers, task.num_agents
        places = list(product(range(maze.num_cells), repeat=agents))
        masks = list(product((0, 1), repeat=task.num_evaders))
        self.states = list(product(places, masks))
        number = {state: n for n, state in enumerate(self.states)}
        joint = list(product(range(task.num_actions), repeat=agents))
        self.next = np.empty((len(self.states), len(joint)), dtype=np.int64)
        for n, (cells, free) in enumerate(self.states):
            for j, actions in enumerate(joint):
                to = [int(maze.neighbors[c, a]) for c, a in zip(cells, actions, strict=True)]
                to[chasers:] = [
                    t if f else c
                    for t, f, c in zip(to[chasers:], free, cells[chasers:], strict=True)
                ]
                left = tuple(
                    int(
                        f
                        and not any(
                            to[c] == to[e] or (to[c] == cells[e] and to[e] == cells[c])
                            for c in range(chasers)
                        )
                    )
                    for e, f in enumerate(free, start=chasers)
                )
                self.next[n, j] = number[tuple(to), left]
        self.task, self.over = task, np.array([not any(free) for _, free in self.states])
        starts = [len({*cells}) == agents and all(free) for cells, free in self.states]
        self.starts = np.array(starts)
        self.actions = (task.num_actions,) * agents

    def steps(self, policy: Drawn, deciding: tuple[int, ...], sign: float) -> float:
        """Mean steps until the last capture, if these agents minimise `sign` times them jointly."""
        cells = np.array([cells for cells, _ in self.states])
        free = np.array([free for _, free in self.states])
        games: Any = type("Games", (), {})()
        games.position = cells
        games.active = np.hstack([np.ones((len(cells), self.task.num_chasers), int), free])
        letters = ascii_lowercase[: len(self.actions)]
        fixed = [s for s in range(len(self.actions)) if s not in deciding]
        rows = [policy.distribution(self.task, games, seat) for seat in fixed]
        to = "".join(letters[s] for s in deciding)
        form = ",".join([f"z{letters}", *(f"z{letters[s]}" for s in fixed)]) + f"->z{to}"
        values = np.zeros(len(cells))
        for _ in range(HORIZON):
            after = values[self.next].reshape(-1, *self.actions)
            options = np.einsum(form, after, *rows).reshape(len(cells), -1)
            values = np.where(self.over, 0.0, 1.0 + sign * (sign * options).min(axis=1))
        return float(values[self.starts].mean())


@pytest.mark.parametrize(
    ("maze", "chasers", "evaders", "role"),
    [
        ("3x3", 2, 1, "chaser"),
        ("2x2", 3, 1, "chaser"),
        ("2x2", 2, 2, "chaser"),
        ("2x2", 2, 2, "evader"),
        ("3x3", 1, 2, "evader"),
    ],
)
def test_teams_and_their_members_against_plain_value_iteration(
    maze: str, chasers: int, evaders: int, role: str
) -> None:
    task = make_task(
        "chase", maze=maze, num_chasers=chasers, num_evaders=evaders, max_steps=HORIZON
    )
    policy, game = Drawn(task, 1), Plain(task)
    contest = TeamContest(task, role, {"chaser": policy, "evader": policy}, 4000)
    sign = 1.0 if role == "chaser" else -1.0
    best, seats = game.steps(policy, contest.seats, sign), contest.seats
    score = contest.score("drawn", policy)
    assert score.exact and score.mean_steps == pytest.approx(game.steps(policy, (), 1.0))
    assert contest.best == pytest.approx(best)
    found = contest.members(policy)
    known = {task.agent_names[seat]: game.steps(policy, (seat,), sign) for seat in seats}
    assert found == pytest.approx(known)
    assert sign * best <= min(sign * value for value in known.values())
    assert max(sign * value for value in known.values()) < sign * score.mean_steps
    result = team_results(contest, policy, score)
    assert result["gap"] == pytest.approx(score.mean_steps / best - 1.0)
    for member, value in known.items():
        gap = result["members"][member]["gap"]
        assert gap == pytest.approx(score.mean_steps / value - 1.0)
    # Its policy attains the value.
    response = contest.best_in()
    assert response is not None
    lengths, won = contest.play(response.policy)
    assert abs(lengths.mean() - best) <= 4.0 * lengths.std() / len(lengths) ** 0.5
    optimum = contest.optimal()
    assert optimum is not None and optimum.mean_steps == contest.best
    assert optimum.success_rate == won.mean()
    # The simulation of the team itself.
    lengths, won = contest.play(policy)
    assert abs(lengths.mean() - score.mean_steps) < 4.0 * lengths.std() / len(lengths) ** 0.5
    assert abs(won.mean() - score.success_rate) < 4.0 * (won.std() + 0.01) / len(won) ** 0.5


class Waits:
    """Stands still."""

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        return np.tile(np.eye(task.num_actions)[-1], (len(games.steps), 1))

    def act(self, view: GameView) -> NDArray[np.int32]:
        return np.full(view.num_games, view.task.num_actions - 1, dtype=np.int32)


def test_a_failure_of_coordination_is_told_from_weak_members() -> None:
    """Two chasers must be in the cell of an evader that waits; each waits for the other."""
    rules: dict[str, Any] = {"stay_action": True, "n_catch": 2, "max_steps": 9}
    task = make_task("chase", maze="3x3", num_chasers=2, **rules)
    contest = TeamContest(task, "chaser", {"evader": Waits()}, 50)
    score = contest.score("waits", Waits())
    found = team_results(contest, Waits(), score)
    assert found["steps"] == 9.0 and found["gap"] > 0.5
    assert [own["gap"] for own in found["members"].values()] == [0.0, 0.0]
    # A weak member has a gap of its own.
    weak = team_results(contest, RandomAgent(), contest.score("random", RandomAgent()))
    assert all(own["gap"] > 0.1 for own in weak["members"].values())


def test_with_exits_a_team_is_measured_by_captures_minus_escapes() -> None:
    task = make_task("escape", maze="3x3-open", exits=[2, 6], num_chasers=2, max_steps=12)
    pair: Any = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    contest = TeamContest(task, "chaser", pair, 3000)
    score, played = contest.score("A*", pair["chaser"]), evaluate_joint(task, pair, 12)
    assert score.exact and score.outcome == pytest.approx(played.returns["chaser_0"])
    both = solve_joint(task, "chaser", pair, 12, objective="return").mean_over_starts / 2.0
    assert contest.best == pytest.approx(both)
    optimum = contest.optimal(contest.measure)
    assert optimum is not None and optimum.outcome == pytest.approx(both)
    found = team_results(contest, pair["chaser"], score)
    assert found["gap"] == pytest.approx(both - played.returns["chaser_0"])
    alone = solve_joint(task, "chaser_1", pair, 12, objective="return").mean_over_starts
    assert found["members"]["chaser_1"]["best_response"] == pytest.approx(alone)
    assert 0.0 <= found["members"]["chaser_1"]["gap"] <= found["gap"]
    two = replace(task, num_chasers=1, num_evaders=2)
    evaders = TeamContest(two, "evader", pair, 3000)
    score = evaders.score("A*", pair["evader"])
    value, sampled = evaders.value_of(pair["evader"]), evaders.values(pair["evader"])
    assert not score.exact and score.outcome == pytest.approx(sampled.mean())
    assert abs(sampled.mean() - value) < 4.0 * sampled.std() / len(sampled) ** 0.5
    found = team_results(evaders, pair["evader"], score)
    assert found["exact"] and found["outcome"] == value
    members = [own["best_response"] for own in found["members"].values()]
    assert evaders.best is not None and evaders.best <= min(members) <= max(members) <= value


def test_evaders_of_a_heist_share_their_returns() -> None:
    task = make_task("heist", maze="3x3-tree", num_evaders=2, num_goals=1, max_steps=8)
    pair: Any = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    contest = TeamContest(task, "evader", pair, 3000)
    score = contest.score("A*", pair["evader"])
    returns = evaluate_joint(task, pair, 8).returns
    value = returns["evader_0"] + returns["evader_1"]
    sampled = contest.values(pair["evader"])
    assert score.mean_return == pytest.approx(sampled.mean())
    assert abs(sampled.mean() - value) < 4.0 * sampled.std() / len(sampled) ** 0.5
    found = team_results(contest, pair["evader"], score)
    assert found["return"] == pytest.approx(value)
    best = solve_joint(task, "evader", pair, 8, objective="return").mean_over_starts
    assert found["gap"] == pytest.approx(best - value)
    assert all(0.0 <= own["gap"] <= found["gap"] for own in found["members"].values())


def test_with_limited_views_the_best_response_is_a_bound() -> None:
    task = make_task("chase", maze="3x3", num_chasers=2, view_radius="chaser=1", max_steps=50)
    contest = TeamContest(task, "chaser", {"evader": AStarEvader(0.2)}, 500)
    scores = contest.baselines()
    names = [score.name for score in scores]
    assert names == ["random", "A* chaser", "searching chaser", "optimal, full view"]
    learned = contest.score("learned", RandomAgent())
    held = contest.reference([*scores, learned], learned)
    assert held is not None and (held.kind, held.name) == ("bound", "optimal, full view")
    whole = TeamContest(replace(task, view_radius=None), "chaser", contest.opponents, 500)
    assert contest.best == whole.best == held.value
    found = team_results(contest, RandomAgent(), learned, [*scores, learned])
    interval, searching = found["interval"], scores[2]
    assert interval["bound"] == contest.best < interval["achieved"] == searching.mean_steps
    assert (interval["name"], interval["exact"]) == ("searching chaser", False)
    text = "\n".join(describe_team(found))
    assert "best team response, full view" in text
    assert f"lies between {contest.best:.3f} (best team response, full view; proven)" in text
    # The view of one member is enough.
    one = replace(task, view_radius="chaser_1=1")
    assert TeamContest(one, "chaser", contest.opponents, 500).is_limited
    # A policy with memory has no exact value, but a bound.
    kept = contest.limited["searching chaser"]
    found = team_results(contest, kept, searching, scores)
    assert found["members"] == {} and "searching" in found["members_reason"].lower()
    assert found["gap"] == pytest.approx(searching.mean_steps / contest.best - 1.0)


def test_a_team_that_is_too_large_says_so() -> None:
    task = make_task("chase", maze="4x4", num_chasers=6)
    contest = TeamContest(task, "chaser", {"evader": AStarEvader(0.2)}, 20)
    contest = contest.solved_up_to(MAX_EVALUATED_WORK)
    scores = contest.baselines()
    assert [score.name for score in scores] == ["random", "A* chaser"]
    held = contest.reference(scores, scores[0])
    assert held is not None and held.kind == "best known"
    found = team_results(contest, RandomAgent(), scores[0], scores)
    assert found["best_response"] is None and found["members"] == {}
    (line,) = describe_team(found)
    states = f"{16**7:,}"
    assert f"no exact best team response: {states} states" in line and "at most" in line


def test_what_is_no_team_is_refused() -> None:
    race = make_task("race", maze="3x3")
    with pytest.raises(ValueError, match="2 runners compete for the same goals"):
        TeamContest(race, "runner", {})
    chase = make_task("chase", maze=["3x3", "3x3-open"], num_chasers=2)
    with pytest.raises(ValueError, match="evaluated in one maze, but the task has 2"):
        TeamContest(chase, "chaser", {"evader": AStarEvader()})
    with pytest.raises(ValueError, match="a team is a role"):
        TeamContest(replace(chase, maze="3x3"), "chaser_0", {"evader": AStarEvader()})


def test_a_team_of_one_is_a_single_agent() -> None:
    for maze in ("3x3", "3x3-tree"):
        task = make_task("chase", maze=maze, max_steps=40)
        how: Any = ({"evader": AStarEvader(0.2)}, 500)
        team, single = TeamContest(task, "chaser", *how), GameContest(task, "chaser", *how)
        assert team.baselines() == single.baselines() and team.measure == BY_STEPS
