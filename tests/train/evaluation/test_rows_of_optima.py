"""All numbers in the row of an optimum belong to one policy, or the row says which do not."""

from __future__ import annotations

import re
from itertools import product
from math import prod
from typing import Any

import pytest
from small_games import GAMES, RandomGame, random_tables

from pursuit.tasks.task import make_task
from scripted_agents import RandomAgent
from scripted_agents.games import GameTask, TableAgent, enumerate_game
from train.commands.main import main
from train.evaluation.small_game_contest import SmallGameContest
from train.runs.parts import contest_of
from train.settings.task import TaskSettings


def recursion(game: Any, player: str, tables: Any, steps: int) -> tuple[float, float, float]:
    """The return, the steps and the chance of an end of an optimal play, by recursion over joint
    actions and their outcomes; of equally good actions the first."""
    own, source = game.player(player), game.following.tocsr()
    row_of = {}
    for state in range(game.num_states):
        first = int(game.begins[state])
        legal = [range(len(names[state])) for names in game.actions]
        row_of.update({(state, *each): first + n for n, each in enumerate(product(*legal))})
    values = [(0.0, 0.0, 0.0)] * game.num_states
    for _ in range(steps):
        after = []
        for state in range(game.num_states):
            legal = [range(len(names[state])) for names in game.actions]
            options = []
            for action in legal[own]:
                total = [0.0, 1.0, 0.0]
                for joint in product(*legal[:own], [action], *legal[own + 1 :]):
                    row = row_of[(state, *joint)]
                    chance = prod(
                        tables[name][game.offsets(seat)[state] + joint[seat]]
                        for seat, name in enumerate(game.players)
                        if seat != own
                    )
                    total[0] += chance * float(game.rewards[row, own])
                    going = 0.0
                    for place in range(source.indptr[row], source.indptr[row + 1]):
                        weight, then = float(source.data[place]), values[source.indices[place]]
                        going += weight
                        for number in range(3):
                            total[number] += chance * weight * then[number]
                    total[2] += chance * (1.0 - going)
                options.append(tuple(total))
            most = max(option[0] for option in options)
            after.append(next(option for option in options if option[0] >= most - 1e-12))
        values = after
    return tuple(  # type: ignore[return-value]
        sum(float(game.start[s]) * values[s][number] for s in range(game.num_states))
        for number in range(3)
    )


@pytest.mark.parametrize("steps", [1, 3, 12])
@pytest.mark.parametrize("name", [*GAMES, "rarely over"])
def test_the_optimum_of_a_small_game_is_one_play(name: str, steps: int) -> None:
    game = (
        enumerate_game(RandomGame(2, seed=5, ends=0.02)) if name == "rarely over" else GAMES[name]()
    )
    task, tables = GameTask(game, name, steps), random_tables(game, 1)
    player = game.players[0]
    others = {n: TableAgent(task, n, tables[n]) for n in game.players if n != player}
    (best,) = [
        score
        for score in SmallGameContest(task, player, others).baselines()
        if score.name == "optimal return"
    ]
    assert best.mean_return is not None
    found = best.mean_return, best.mean_steps, best.success_rate
    assert found == pytest.approx(recursion(game, player, tables, steps), abs=1e-9)


def test_the_optimum_of_a_duel_has_the_captures_of_its_own_steps() -> None:
    """With a time limit the action of the last step is another than that of the first."""
    contest: Any = contest_of(
        TaskSettings(task="chase", role="chaser", maze="5x5", max_steps=6), 100
    )
    best, played = contest.best_in(), contest.optimal()
    assert played.exact and played.apart == ""
    own = contest.score("", contest.opponents["chaser"])
    assert played.mean_steps <= own.mean_steps and played.success_rate > own.success_rate
    assert played.success_rate == pytest.approx(
        best.captured[make_task("chase", maze="5x5").mazes[0].distances >= 1].mean()
    )


@pytest.mark.parametrize(
    ("options", "row"),
    [
        ("--task chase --num-chasers 2 --maze 3x3", r"optimal .* exact, success: sampled "),
        ("--task escape --role chaser --maze 3x3 --num-exits 1", r"0\.410 +exact, the +5\.300"),
        ("--task race --maze 3x3 --num-goals 1", r"optimal goals .* the rest sampled "),
    ],
)
def test_rows_say_what_is_sampled_beside_an_exact_optimum(
    options: str, row: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["baseline", *options.split(), "--max-steps", "20", "--episodes", "20"])
    said = capsys.readouterr().out
    assert re.search(row, said) and "sampled" in said


class Played:
    """A random agent of which only games are known, and no distribution."""

    def act(self, view: Any) -> Any:
        return RandomAgent().act(view)


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_an_evader_wins_escapes_at_an_exit_alone(role: str) -> None:
    """Exactly and in sampled games; the interval is that of captures minus escapes."""
    settings = TaskSettings(task="escape", role=role, maze="3x3", max_steps=3)
    exact: Any = contest_of(settings, 4000)
    score, drawn = (exact.score("random", policy) for policy in (RandomAgent(), Played()))
    for one in (score, drawn):
        own = one.capture_rate if role == "chaser" else one.escape_rate
        assert one.success_rate == own and one.timeout_rate > 0.05
    assert score.exact and score.value_ci95 == 0.0 and not drawn.exact
    assert (
        drawn.value_ci95 is not None and abs(drawn.outcome - score.outcome) < 3 * drawn.value_ci95
    )
    assert drawn.value_ci95 != drawn.ci95
