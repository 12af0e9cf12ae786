"""Self-play and leagues from the command line."""

from __future__ import annotations

import json
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from self_play_runs import go_on, make_run, make_settings, sides_of_task

from pursuit.mazes.maze import load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    OptimalChaser,
    OptimalEvader,
    RandomAgent,
    mean_over_starts,
    solve_chase,
)
from scripted_agents.environments import chosen_policies
from scripted_agents.names import roles_of_agent
from train.commands.main import main
from train.evaluation.matchups import match
from train.kinds import resume, start
from train.play.setup import name_of
from train.runs.folder import RUN, SELF_PLAY
from train.runs.opponents import opponents_of, policy_of
from train.runs.parts import contest_of, parts_of, settings_of
from train.self_play.league import Entry, LeagueTable, enter, play_league, rate
from train.self_play.parts import self_play_parts, self_play_settings_of
from train.self_play.payoffs import payoff_tables
from train.settings.task import TaskSettings

# -- the commands ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_commands_from_self_play_to_league(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = ["self-play", "--maze", "3x3", "--frames", "4000", "--num-games", "64"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main([*run, "--minibatch-size", "512", "--out", "a"])
        main([*run, "--minibatch-size", "512", "--seed", "1", "--no-report", "--out", "b"])
    printed = capsys.readouterr().out
    assert "NashConv" in printed and "rows: chasers, columns: evaders" in printed
    results = json.loads((tmp_path / "a" / "results.json").read_text())
    assert results["evaluation"]["nash_conv"] > 0
    steps = {(row["chaser"], row["evader"]): row["steps"] for row in results["matches"]}
    assert len(steps) == 16 and steps["learned", "learned"] == results["evaluation"]["steps"]
    assert (tmp_path / "a" / "learning_curve.png").stat().st_size > 10_000
    main(["league", "a", "b", "a/chaser", "astar", "random", "--games", "50", "--out", "l"])
    printed = capsys.readouterr().out
    assert "Elo" in printed and "Nash share" in printed
    content = json.loads((tmp_path / "l" / "league.json").read_text())
    assert content["chasers"] == ["a", "b", "a/chaser", "astar", "random"]
    assert content["evaders"] == ["a", "b", "astar", "random"]
    assert content["payoff"][0] == content["payoff"][2]  # one and the same chaser
    elo = {row["name"]: row["elo"] for row in content["chaser_ratings"]}
    assert elo["astar"] > elo["random"]
    main(["evaluate", "a/evader", "--episodes", "20"])
    assert "optimal" in capsys.readouterr().out


def test_a_run_of_self_play_is_resumed_by_its_own_command(tmp_path: Path) -> None:
    make_run(tmp_path / "run", frames=1000).train()
    with pytest.raises(ValueError, match="resume it by `pursuit self-play --resume"):
        resume(tmp_path / "run", RUN)
    with pytest.raises(ValueError, match="one side of self-play"):
        go_on(tmp_path / "run" / "chaser")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["league"], "no entries"),
        (["league", "astar", "astar"], "two entries are called 'astar'"),
        (["league", "nowhere"], "'nowhere': neither a folder of a run"),
        (["league", "astar", "--games", "1"], "games=1"),
        (["solve", "--maze", "5x6"], "unknown maze '5x6'"),
        (["solve", "--discount", "1.5"], "discount=1.5"),
        (["solve", "--evader-cell", "99"], "evader_cell=99"),
        (["self-play", "--resume", "nowhere"], "no such folder"),
        (["self-play", "--window", "0"], "window=0"),
    ],
)
def test_wrong_command_lines_are_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_runs_of_another_game_do_not_enter_a_league(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = {}
    for name, changes in {
        "three": {},
        "four": {"task": {"maze": "4x4"}},
        "stay": {"task": {"stay_action": True}},
    }.items():
        run = make_run(tmp_path / name, frames=2000, **changes)  # type: ignore[arg-type]
        run.train()
        folders[name] = str(tmp_path / name)
    for other, message in (("four", "was trained in maze 4x4"), ("stay", "stay_action=True")):
        with pytest.raises(SystemExit):
            main(["league", folders["three"], folders[other]])
        assert message in capsys.readouterr().err


def test_cycles_are_reported() -> None:
    rock = np.array([[10, 5, 15], [15, 10, 5], [5, 15, 10]])
    lengths = np.repeat(rock[:, :, None], 20, axis=2)
    table = LeagueTable(["a", "b", "c"], ["x", "y", "z"], rock.astype(float), 0.0 * rock, lengths)
    content = rate(table)
    assert len(content["cycle"]) == 6
    assert content["nash"]["chaser_mixture"] == pytest.approx([1 / 3] * 3, abs=1e-3)
    settled = np.array([[10, 12], [20, 22]])
    table = LeagueTable(
        ["a", "b"], ["x", "y"], settled.astype(float), 0.0 * settled,
        np.repeat(settled[:, :, None], 20, axis=2),
    )  # fmt: skip
    assert rate(table)["cycle"] == []


def test_solve_prints_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["solve", "--maze", "5x5-tree", "--out", str(tmp_path / "s.png")])
    printed = capsys.readouterr().out
    assert "cop number (alternating moves)  1" in printed and "one action is optimal" in printed
    assert "20 if never caught, 1 / (1 - discount)" in printed
    assert (tmp_path / "s.png").stat().st_size > 10_000


def test_solve_by_population_methods(capsys: pytest.CaptureFixture[str]) -> None:
    main(["solve", "--maze", "3x3-tree", "--method", "double-oracle", "--discount", "0.99"])
    oracle = capsys.readouterr().out
    value = mean_over_starts(solve_chase(load_maze("3x3-tree"), 0.99).values, load_maze("3x3-tree"))
    assert f"{value:.6f} steps, discounted; error at most 1e-06" in oracle
    assert "iteration 1  " in oracle and "actions per state: chaser 1.00" in oracle
    main(["solve", "--maze", "3x3-tree", "--method", "fictitious-play", "--stay-action"])
    play = capsys.readouterr().out
    assert "iteration 1000 " in play and "with stay" in play and "s by fictitious-play" in play


def test_all_learned_opponents_use_the_same_policy_option(tmp_path: Path) -> None:
    """As it was learned, unless `opponent_policy` says greedy; in training and in self-play."""
    run = make_run(tmp_path / "pair", frames=2000)
    run.train()
    folder = tmp_path / "pair" / "evader"
    for chosen, greedy in (({}, False), ({"opponent_policy": "greedy"}, True)):
        settings = settings_of(maze="3x3", opponent=str(folder), frames=1, **chosen)
        trained = parts_of(settings).world.opponents["evader"]
        game = {"maze": "3x3", "rewards": "zero_sum", **chosen}
        frozen = make_settings(evader=str(folder), task=game)
        played = self_play_parts(frozen).frozen["evader"]
        evaluated = contest_of(settings.task, 2).opponents["evader"]
        assert [p.greedy for p in (trained, played, evaluated)] == [greedy] * 3  # type: ignore
    with pytest.raises(ValueError, match="unknown opponent_policy 'best'; one of sampled, greedy"):
        settings_of(opponent=str(folder), frames=1, opponent_policy="best")


def test_evaluations_never_use_training_seeds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seeds: list[int] = []

    class Spied(Simulator):
        def seed(self, seed: int, games: Any = None) -> None:
            seeds.append(seed)
            super().seed(seed, games)

    monkeypatch.setattr("train.evaluation.maze_contest.MazeContest.simulator", Spied)
    monkeypatch.setattr("train.evaluation.matchups.Simulator", Spied)
    monkeypatch.chdir(tmp_path)
    main(["league", "astar", "random", "--maze", "3x3", "--games", "2", "--seed", "5"])
    assert set(seeds) == {2**62 + 5, 2**62}  # its page plays starts of the usual evaluations
    seeds.clear()
    main(["baseline", "--task", "maze", "--maze", "3x3", "--episodes", "2", "--seed", "5"])
    assert set(seeds) == {2**62 + 5}
    seeds.clear()
    main(["baseline", "--task", "maze", "--maze", "3x3", "--episodes", "2"])
    contest_of(TaskSettings(task="maze", maze="3x3"), 2).starts()
    assert set(seeds) == {2**62}
    for make in (settings_of, self_play_settings_of):
        with pytest.raises(ValueError, match=r"seed=4611686018427387904; give 0 to 2\*\*62-1"):
            make(frames=1, seed=2**62)


def test_the_random_moves_of_astar_are_part_of_its_name() -> None:
    for epsilon, called, name in (
        (0.2, (), "astar (epsilon 0.2)"),
        (0.0, (), "astar"),
        (0.2, ("A-star",), "A-star"),
    ):
        _, entries = enter(["astar"], "3x3", epsilon, called=called)
        assert {entry.name for entry in entries} == {name}


def test_opponents_by_name_in_training() -> None:
    for name in ("random", "optimal", "astar"):
        opponents = opponents_of(make_task("chase"), "chaser", name, 0.1)
        form = {"random": RandomAgent, "optimal": OptimalEvader, "astar": AStarEvader}[name]
        assert type(opponents["evader"]) is form


def test_evaders_that_are_never_caught_are_reported(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """On 5x5 one chaser never catches the optimal evader: ranks of chasers say nothing of that."""
    entries = ["league", "astar", "random", "equilibrium", "--games", "30", "--out"]
    main([*entries, str(tmp_path / "open")])
    told = capsys.readouterr()
    assert "never caught by any chaser here: equilibrium; the steps until capture are" in told.err
    assert "all chasers are equal" in told.err and "never" in told.out
    assert "astar: epsilon 0; equilibrium: an equilibrium policy of the discounted game" in told.out
    content = json.loads((tmp_path / "open" / "league.json").read_text())
    assert content["never_caught"] == ["equilibrium"] and content["never_catches"] == []
    assert content["ranks_mean_nothing"] == ["chaser"]
    assert [row[2] for row in content["out_of_time"]] == [1.0, 1.0, 1.0]
    page = (tmp_path / "open" / "report.html").read_text(encoding="utf-8")
    assert page.count('src="data:image/svg+xml;base64,') == 1 and "<h1>League on 5x5</h1>" in page
    for text in ("Payoffs", "Elo [95 %]", "never caught by any chaser here", "Command"):
        assert text in page
    main([*entries, str(tmp_path / "tree"), "--maze", "5x5-tree"])
    assert "never caught" not in capsys.readouterr().err


def test_the_page_plays_the_notable_pairs(browser: Any, tmp_path: Path) -> None:
    entries = ["astar", "random", "equilibrium", "--maze", "3x3", "--games", "20"]
    main(["league", *entries, "--out", str(tmp_path / "l")])
    content = json.loads((tmp_path / "l" / "league.json").read_text())
    payoff = np.array(content["payoff"])
    tab = browser.new_page(reduced_motion="reduce")
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto((tmp_path / "l" / "report.html").as_uri())
    shown = dict(
        reversed(text.split(": ")) for text in tab.locator(".episodes button").all_text_contents()
    )
    best = [
        max(content[f"{role}_ratings"], key=lambda row: row["elo"])["name"]
        for role in ("chaser", "evader")
    ]
    for why, find in (("least payoff", np.argmin), ("largest payoff", np.argmax)):
        row, column = np.unravel_index(find(payoff), payoff.shape)
        pair = f"{content['chasers'][row]} against {content['evaders'][column]}"
        assert [name for reasons, name in shown.items() if why in reasons] == [pair]
    assert " against ".join(best) in [n for why, n in shown.items() if "best rated" in why]
    assert tab.locator(".stage svg .token").count() == 2 and not errors
    tab.close()


def test_the_former_name_of_equilibrium_is_accepted_and_the_new_one_shown(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """It was called "optimal" and can rank last: it is no best response to these opponents."""
    assert TaskSettings(opponent="optimal") == TaskSettings(opponent="equilibrium")
    for where in ("chaser", "evader", "members"):
        former, new = (
            {where: [name] if where == "members" else name, "frames": 10**6, "maze": "3x3"}
            for name in ("optimal", "equilibrium")
        )
        settings = self_play_settings_of(**former)
        assert settings == self_play_settings_of(**new)
        assert "optimal" not in str(asdict(settings))
    main(["league", "optimal", "--maze", "3x3-tree", "--games", "10", "--out", str(tmp_path / "l")])
    assert "optimal" not in capsys.readouterr().out
    assert "optimal" not in (tmp_path / "l" / "table.csv").read_text()
    content = json.loads((tmp_path / "l" / "league.json").read_text())
    assert content["chasers"] == content["evaders"] == content["entries"] == ["equilibrium"]
    with pytest.raises(ValueError, match="two entries are called 'equilibrium'"):
        enter(["optimal", "equilibrium"], "3x3-tree")
    with pytest.raises(ValueError, match="model_roles: 1 for 0 models without a description"):
        enter(["optimal"], "3x3-tree", model_roles=["chaser"])
    task = make_task("chase", maze="3x3-tree")
    opponents = chosen_policies(task, "chaser", "optimal", 0.0)
    assert isinstance(opponents["evader"], OptimalEvader)
    assert isinstance(policy_of(TaskSettings(), "optimal", task, "chaser"), OptimalChaser)
    assert roles_of_agent("optimal", task) == ("chaser", "evader")


@pytest.mark.parametrize(
    ("given", "role", "shown"),
    [
        ("optimal", "chaser", "equilibrium"),
        ("equilibrium", "evader", "equilibrium"),
        ("optimal", "runner", "optimal"),  # its tour is the optimum
        ("equilibrium", "runner", "optimal"),
    ],
)
def test_the_name_in_play_is_that_of_what_is_played(given: str, role: str, shown: str) -> None:
    assert name_of(given, role) == shown


def test_equilibrium_is_refused_where_it_is_not_known(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, message in (
        (
            ["self-play", "--maze", "15x15", "--num-chasers", "2", "--evader", "equilibrium"],
            "bytes",
        ),
        (["self-play", "--num-evaders", "2", "--members", "optimal"], "2 evader(s)"),
        (["train", "--task", "heist", "--opponent", "equilibrium"], "3 goal(s)"),
        (
            ["render", "--task", "maze", "--maze", "9x9", "--num-goals", "19", "--optimal"],
            "19 goals",
        ),
        (["solve", "--maze", "15x15", "--num-chasers", "2"], "bytes"),
    ):
        with pytest.raises(SystemExit):
            main(arguments)
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1


def test_an_equilibrium_that_is_not_known_is_refused_before_anything_is_loaded_or_enumerated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It once came after the loading of all runs, and after 87 s of enumeration."""
    team = self_play_settings_of(
        maze="15x15", num_chasers=2, frames=512, num_games=16, rollout_steps=8, minibatch_size=128,
        max_steps=8, width=8, threads=1,
    )  # fmt: skip
    start(SELF_PLAY, team, tmp_path / "run").train()

    def too_early(*given: Any, **named: Any) -> Any:
        raise AssertionError("expensive work before the refusal")

    monkeypatch.setattr("train.self_play.league.loaded_policy", too_early)
    with pytest.raises(ValueError, match="bytes"):
        enter([str(tmp_path / "run"), "equilibrium"], None)
    monkeypatch.setattr("train.settings.task.load_game", too_early)
    pytest.importorskip("pyspiel")
    goofspiel = "openspiel:goofspiel(imp_info=False,returns_type=total_points,players={})"
    with pytest.raises(ValueError, match="general-sum game, whose equilibrium is not computed"):
        enter(["uniform", "equilibrium"], game=goofspiel.format(2))
    with pytest.raises(ValueError, match="3 players; a league needs two"):
        enter(["uniform"], game=goofspiel.format(3))


def test_payoffs_of_escapes_have_the_sign_of_self_play(tmp_path: Path) -> None:
    """Captures minus escapes: in the table, in the figures, against the Nash mixture, and for teams
    beside their best response."""
    task = make_task("escape", maze="3x3", num_chasers=2, max_steps=12)
    agents: list[tuple[str, Any]] = [("astar", 0.1), ("weak", 0.9)]
    entries = [
        Entry(name, role, form(epsilon))
        for role, form in (("chaser", AStarChaser), ("evader", AStarEvader))
        for name, epsilon in agents
    ]
    sides = sides_of_task(task)
    table = play_league(sides, entries, 400, 0)
    content = rate(table)
    assert content["unit"] == table.measure.unit == "captures - escapes (chasers want more)"
    for i, chaser in enumerate(entries[:2]):
        for j, evader in enumerate(entries[2:]):
            found = match(task, chaser.policy, evader.policy)
            assert content["payoff"][i][j] == found.shown == found.outcome == table.shown[i, j]
    strong, weak = content["chaser_ratings"]
    assert strong["elo"] > weak["elo"] and strong["steps_against_nash"] > weak["steps_against_nash"]
    assert np.min(content["payoff"]) <= content["nash"]["value"] <= np.max(content["payoff"])
    for row in sides.team_rows(entries, table):
        other = next(e for e in entries[2:] if e.name == row["against"])
        own = next(e for e in entries[:2] if e.name == row["team"])
        assert row["payoff"] == match(task, own.policy, other.policy).outcome
        assert row["best_response"] >= row["payoff"] and row["gap"] >= 0.0
    drawn = payoff_tables(table, content)["table"].markdown()
    assert f"{table.shown[0, 0]:.2f}" in drawn
