"""The commands `solve`, `baseline`, `evaluate` and `export` in small games, and bad input."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from command_errors import error_of, run
from small_games import Nim

import train
from pursuit import plugins

NIM = "small_games:Nim(heap=7)"
STEPS = 10
TINY = [
    *("--num-games", "32", "--max-steps", str(STEPS), "--width", "16"),
    *("--threads", "1", "--no-report"),
]
PPO = [*TINY, "--rollout-steps", "4", "--minibatch-size", "64", "--frames", "1500"]


def content_of(folder: Path) -> dict[str, str]:
    """The hash of every file."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path): sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs: self-play of both players, of one player, and of a single player."""
    folder = tmp_path_factory.mktemp("runs")
    common = ["--game", NIM, *PPO]
    run("self-play", *common, "--snapshots", "2", "--out", folder / "pair")
    fixed = ["--second", "command_games:one", "--opponent-epsilon", "0.3"]
    run("self-play", *common, *fixed, "--snapshots", "2", "--out", folder / "alone")
    run("train", *common, "--player", "second", "--out", folder / "second")
    table = ["--algorithm", "q_learning", "--frames", "2048"]
    run("train", "--game", NIM, *TINY[:4], "--no-report", *table, "--out", folder / "table")
    return folder


# -- an independent reference: recursion over the functions of the game --------------------------


def play(game: Any, policies: Sequence[Any], best: int | None) -> tuple[float, float]:
    """The returns of both players of a turn-based game within `STEPS`.

    Args:
        game: the `Game`.
        policies: of each player, a dict by state of a dict by action.
        best: a player that plays its best response instead of its policy.
    """

    @cache
    def value(state: Any, left: int) -> tuple[float, float]:
        if left == 0:
            return (0.0, 0.0)
        mover = state[1]
        options: dict[Any, tuple[float, float]] = {}
        for action in game.legal_actions(state, mover):
            actions = (action, None) if mover == 0 else (None, action)
            [(_, after, rewards, over)] = game.transitions(state, actions)
            later = (0.0, 0.0) if over else value(after, left - 1)
            options[action] = (rewards[0] + later[0], rewards[1] + later[1])
        if mover == best:
            return max(options.values(), key=lambda found: found[mover])
        chances = policies[mover][state]
        first, second = (sum(chances[a] * found[p] for a, found in options.items()) for p in (0, 1))
        return first, second

    starts = [(chance, value(state, STEPS)) for chance, state in game.starts()]
    return (
        sum(chance * found[0] for chance, found in starts),
        sum(chance * found[1] for chance, found in starts),
    )


def by_state(policy: Any) -> dict[Any, dict[Any, float]]:
    """The table of a learned policy as dicts."""
    game = policy.task.game
    seat = game.player(policy.agent)
    pieces = np.split(policy.table(policy.task), game.offsets(seat)[1:-1])
    rows = zip(game.states, game.actions[seat], pieces, strict=True)
    return {state: dict(zip(acts, row.tolist(), strict=True)) for state, acts, row in rows}


def mixed(name: str, player: int, epsilon: float = 0.0) -> dict[Any, dict[Any, float]]:
    """Uniform play of Nim, or "one": take one, with random moves."""
    game, found = Nim(heap=7), {}
    for heap in range(1, 8):
        for mover in (0, 1):
            legal = list(game.legal_actions((heap, mover), player))
            share = 1.0 if name == "uniform" else epsilon
            row = {action: share / len(legal) for action in legal}
            row[legal[0]] += 1.0 - share
            found[heap, mover] = row
    return found


# -- solve ---------------------------------------------------------------------------------------


def test_solve_finds_the_theory_of_nim(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Who is to move loses in multiples of 4, and else wins by leaving one (Bouton, 1901)."""
    out = tmp_path / "nim.json"
    run("solve", "--game", "small_games:Nim(least=1,heap=8)", "--out", out)
    text = capsys.readouterr().out
    assert re.search(r"always end, after at most 8 steps\n", text)
    assert re.search(r"returns +undiscounted\n", text)
    assert re.search(r"value for first +0\.500000 ", text)  # 6 of 8 heaps are won, 2 lost
    assert re.search(r"random in +0 of 15 states \(0\.0 %\)", text)
    content = json.loads(out.read_text())
    assert content["kind"] == "equilibrium" and content["value"] == pytest.approx(0.5)
    assert len(content["states"]) == 15
    for row in content["states"]:
        heap, mover = map(int, re.findall(r"\d+", row["state"]))
        wins = heap % 4 != 0
        assert row["value"] == pytest.approx((1 if wins else -1) * (1 - 2 * mover))
        if wins:
            assert row["policies"][("first", "second")[mover]][str(heap % 4)] == pytest.approx(1.0)
    before = out.read_bytes()
    assert "exists" in error_of(capsys, "solve", "--game", NIM, "--out", out)
    assert out.read_bytes() == before


def test_solve_of_other_games_calls_nothing_an_equilibrium(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Of a point that is given 2/3 come back: playing 0 gains 1/6 against uniform play."""
    game = ("solve", "--game", "command_games:Commons")
    run(*game)
    text = capsys.readouterr().out
    assert "none is computed for this kind of game (3 players)" in text
    for name in "abc":
        assert re.search(rf"return of {name} +0\.500000 in uniform play, 0\.666667 with", text)
    assert re.search(r"NashConv of uniform play +0\.500000\n", text)
    message = error_of(capsys, *game, "--out", tmp_path / "a.json")
    assert "no equilibrium is computed" in message and not (tmp_path / "a.json").exists()


@pytest.mark.parametrize(
    ("team", "best", "uniform"), [("a", 2 / 3, 0.5), ("a,b", 4 / 3, 1.0), ("a,b,c", 3.0, 1.5)]
)
def test_a_team_responds_as_one(
    team: str, best: float, uniform: float, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "team.json"
    run("solve", "--game", "command_games:Commons", "--players", team, "--out", out)
    text = capsys.readouterr().out
    names = re.escape(team.replace(",", " + "))
    assert re.search(rf"best response of {names} +{best:.6f} ", text)
    assert re.search(rf"uniform play of {names} +{uniform:.6f}\n", text)
    content = json.loads(out.read_text())
    assert content["kind"] == "best response to uniform play"
    [row] = content["states"]
    gives = float(len(team) > 1)
    assert row["policies"] == {n: {"0": 1.0 - gives, "1": gives} for n in team.split(",")}


def test_the_horizon_and_the_discount_of_solve(capsys: pytest.CaptureFixture[str]) -> None:
    """One player wins 1 at every second step of `Doors`, as long as both always stay apart."""
    run("solve", "--game", NIM, "--horizon", "1")
    text = capsys.readouterr().out
    assert "undiscounted, within 1 steps" in text
    assert re.search(r"value for first +0\.000000 ", text)  # no heap of 5 is taken at once
    run("solve", "--game", NIM, "--discount", "0.5")
    # Heap 5: won with the third move. Heap 6 and 7: likewise. Discounts of two steps: 0.25.
    assert re.search(r"value for first +0\.250000 ", capsys.readouterr().out)
    run("solve", "--game", "small_games:Doors")
    assert "discounted by 0.95 per step" in capsys.readouterr().out


# -- baseline and evaluate -----------------------------------------------------------------------


def scores_of(text: str) -> dict[str, float]:
    """The returns in a printed table of scores, by name."""
    rows = re.findall(r"^(\S.*?) {2,}(-?\d+\.\d{3}) ", text, re.MULTILINE)
    return {name: float(value) for name, value in rows}


def test_baseline_gives_uniform_play_equilibrium_and_best_response(
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = ("--opponent", "command_games:one", "--opponent-epsilon", "0.3")
    run("baseline", "--game", NIM, "--max-steps", STEPS, "--player", "first", *given)
    found, game = scores_of(capsys.readouterr().out), Nim(heap=7)
    other = mixed("one", 1, 0.3)
    assert found["uniform"] == pytest.approx(
        play(game, [mixed("uniform", 0), other], None)[0], abs=6e-4
    )
    assert found["optimal return"] == pytest.approx(play(game, [None, other], 0)[0], abs=6e-4)
    assert found["uniform"] < found["equilibrium"] <= found["optimal return"]


def test_evaluate_scores_one_player_against_the_other_players_of_its_run(
    runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    game = Nim(heap=7)
    greedy, first = (by_state(train.load_policy(runs / "pair/first", g)) for g in (True, False))
    second = by_state(train.load_policy(runs / "pair/second", greedy=False))
    others = {
        (): second,
        ("--opponent", "uniform"): mixed("uniform", 1),
        ("--opponent", "command_games:one", "--opponent-epsilon", "0.3"): mixed("one", 1, 0.3),
        ("--opponent", str(runs / "second")): by_state(train.load_policy(runs / "second", False)),
        ("--opponent", str(runs / "alone")): mixed("one", 1, 0.3),
    }
    capsys.readouterr()
    for options, other in others.items():
        run("evaluate", runs / "pair/first", *options)
        found = scores_of(capsys.readouterr().out)
        assert found["learned"] == pytest.approx(play(game, [greedy, other], None)[0], abs=6e-4)
        assert found["learned, sampled"] == pytest.approx(
            play(game, [first, other], None)[0], abs=6e-4
        )
        assert found["optimal return"] == pytest.approx(play(game, [None, other], 0)[0], abs=6e-4)
    greedily = ("--opponent", runs / "pair", "--opponent-policy", "greedy")
    run("evaluate", runs / "pair/first", *greedily, "--out", tmp_path / "a.json")
    other = by_state(train.load_policy(runs / "pair/second"))
    evaluation = json.loads((tmp_path / "a.json").read_text())["evaluation"]
    assert evaluation["exact"]
    assert evaluation["mean_return"] == pytest.approx(play(game, [greedy, other], None)[0])
    best = play(game, [None, other], 0)[0]
    assert evaluation["return_regret"] == pytest.approx(best - evaluation["mean_return"])
    gain = play(game, [greedy, None], 1)[1] - play(game, [greedy, other], None)[1]
    assert evaluation["nash_conv"] == pytest.approx(best - evaluation["mean_return"] + gain)


@pytest.mark.parametrize("name", ["pair", "alone"])
def test_evaluate_of_a_whole_run_gives_its_nash_conv_again(
    runs: Path, name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "found.json"
    run("evaluate", runs / name, "--out", out)
    found = json.loads(out.read_text())["evaluation"]
    saved = json.loads((runs / name / "results.json").read_text())["evaluation"]
    assert found == pytest.approx({key: saved[key] for key in found})
    game, first = Nim(heap=7), by_state(train.load_policy(runs / name / "first", False))
    second = mixed("one", 1, 0.3)
    if name == "pair":
        second = by_state(train.load_policy(runs / "pair/second", False))
    both = [first, second]
    gains = [play(game, both, p)[p] - play(game, both, None)[p] for p in (0, 1)]
    assert found["nash_conv"] == pytest.approx(sum(gains))
    assert f"NashConv {sum(gains):.4f}, exact" in capsys.readouterr().out


# -- export --------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".onnx", ".pt2"])
def test_an_exported_network_plays_as_the_table_says(
    runs: Path, suffix: str, tmp_path: Path
) -> None:
    out = tmp_path / f"policy{suffix}"
    run("export", runs / "pair/first", "--out", out)
    policy = train.load_policy(runs / "pair/first", greedy=False)
    task = policy.task
    states = np.arange(task.game.num_states, dtype=np.int32)[:, None]
    if suffix == ".pt2":
        extra = {"pursuit.json": ""}
        program = torch.export.load(out, extra_files=extra).module()
        chances = program(torch.from_numpy(states)).detach().numpy()
        told = json.loads(extra["pursuit.json"])
    else:
        runtime = pytest.importorskip("onnxruntime")
        session = runtime.InferenceSession(out)
        [chances] = session.run(["probabilities"], {"observation": states})
        known = session.get_modelmeta().custom_metadata_map
        told = {name.removeprefix("pursuit."): text for name, text in known.items()}
    legal = np.where(task.legal("first"), chances, 0.0)
    legal[legal < policy.seat.min_probability] = 0.0
    expected = task.flat("first", legal / legal.sum(axis=1, keepdims=True))
    np.testing.assert_allclose(policy.table(task), expected, atol=1e-5)
    assert json.loads(told["task"]) == {
        "game": NIM, "max_steps": STEPS, "players": ["first", "second"],
        "states": task.game.num_states,
    }  # fmt: skip
    assert json.loads(told["actions"]) == ["1", "2", "3", "None"]
    assert (told["agent"], told["observation"]) == ("first", "index")


# -- bad input -----------------------------------------------------------------------------------

DOORS = "small_games:Doors"
BAD_GAMES = {
    "nosuch": "unknown game 'nosuch'",
    "nosuch_module:Game": "module nosuch_module cannot be imported",
    "small_games:Nothing": "has no 'Nothing'",
    "small_games:Nim(size=4)": "does not accept the arguments 'size=4'",
    "small_games:Nim(4)": "give arguments as name=value",
    "small_games:Nim(heap=": "arguments in parentheses",
    "small_games:random_tables(game=1,seed=2)": "raised",
    "small_games:legal_actions": "does not accept",
    "command_games:Raises": "raised IndexError: two lines in legal_actions(",
    "command_games:Unordered": "legal_actions(('left', 'right', 0), 0) returned a set",
    "command_games:Large": "4,000,000,000,000 joint actions in 0 needs",
}


@pytest.mark.parametrize(
    ("command", "game"), zip(cycle(["train", "self-play", "solve", "baseline"]), BAD_GAMES)
)
def test_games_that_are_none(
    command: str, game: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    trains = command in ("train", "self-play")
    out = ["--out", tmp_path / "run", "--frames", "100"] if trains else []
    assert BAD_GAMES[game] in error_of(capsys, command, "--game", game, *out)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("train --player nobody", "player 'nobody'; the players are guard, thief"),
        ("solve --players guard,nobody", "player 'nobody'; the players are guard, thief"),
        ("solve --horizon 0", "horizon=0; it is at least 1"),
        ("solve --discount 1", "give a discount above 0 and below 1, or a horizon"),
        ("solve --out a.npz", "give a .json file"),
        ("self-play --nobody uniform", "Unrecognized options: --nobody"),
        ("self-play --guard uniform --thief uniform", "guard and thief are both fixed"),
        ("self-play --guard nosuch", "'nosuch': not a policy; give one of uniform, equilibrium"),
        ("train --opponent astar", "'astar': not a policy; give one of uniform, equilibrium"),
        ("self-play --guard command_games:half", "give non-negative ones with sum 1"),
        ("baseline --opponent command_games:flies", "thief plays 'fly' in"),
        ("train --opponent command_games:fails", "raised ZeroDivisionError: no policy; mend it"),
        ("train --opponent-epsilon 2", "a share of random moves must be in [0, 1]"),
        ("train --observation planes", "unknown observation 'planes'; one of index, one_hot"),
        ("train --observation observe", "has no function observe(state, player)"),
        ("train --algorithm q_learning --gamma 1", "which can go on forever"),
        ("train --algorithm q_learning --observation one_hot", "has a table over states"),
        ("train --algorithm rnad", "is for self-play"),
        ("train --recurrent gru", "need policies without memory"),
        ("train --frame-stack 2", "need policies without memory"),
        ("self-play --algorithm q_learning", "does not support self-play"),
        ("train --maze 5x5", "Unrecognized options: --maze"),
    ],
)  # fmt: skip
def test_wrong_options(
    line: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    command, *options = line.split()
    trains = command in ("train", "self-play")
    new = ["--out", tmp_path / "run", "--frames", "100"] if trains else []
    assert message in error_of(capsys, command, "--game", DOORS, *options, *new)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("game", "options", "message"),
    [
        ("Seen(what=shapes)", "--observation observe", "return arrays of one shape"),
        ("Seen(what=nan)", "--observation observe", "numbers that are not finite"),
        ("Seen(what=empty)", "--observation observe", "return at least one number"),
        ("Seen(what=text)", "--observation observe", "return an array of numbers"),
        ("Seen(what=raises)", "--observation observe", "raised KeyError"),
        ("Named(name=seed)", "", "a player is called 'seed'; rename it"),
        ("Named(name='a b')", "", "a player is called 'a b'; rename it"),
        (f"Named(name={'a' * 300})", "", "rename it to a word of at most 60 letters"),
        ("Named(name=1)", "", "players=(1, 'thief'); give the name of each player, all different"),
        ("Named(name=thief)", "", "give the name of each player, all different"),
        ("Named(name=a,name=b)", "", "give arguments as name=value, each once"),
        ("Named(name=3x3)", "", "texts (in quotes unless a word)"),
        ("Commons", "--a equilibrium", "3 players; equilibria are computed for two"),
        ("Commons", "--sampling psro", "needs two players with opposite rewards"),
    ],
)
def test_observations_and_players_that_do_not_fit(
    game: str, options: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = ["self-play", "--game", f"command_games:{game}", *options.split()]
    assert message in error_of(capsys, *given, "--frames", "100", "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize("silent", [False, True])
def test_what_cannot_be_drawn_costs_no_result(
    silent: bool, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Where `draw`, or the text of states, raises in some states: one warning, and the results."""
    game, one, pair = f"command_games:Undrawn(silent={silent})", tmp_path / "one", tmp_path / "pair"
    training = ["--game", game, *PPO[:-1], "512"]
    training.remove("--no-report")
    warning = "draw(state) of Undrawn raised KeyError (command_games.py:"
    text = "Silent, whose text raises RuntimeError" if silent else "left"
    for command, page in (
        (["train", *training, "--out", one], one),
        (["self-play", *training, "--out", pair], pair),
        (["view", one, "--out", tmp_path / "report.html"], tmp_path),
        (["report", one, "--out", tmp_path / "report"], None),
        (["render", one, "--out", tmp_path / "one.gif"], None),
        (["solve", "--game", game, "--out", tmp_path / "solved.json"], None),
        (["league", pair, "uniform", "--game", game, "--out", tmp_path / "league"], None),
    ):
        run(*command)
        said = capsys.readouterr().err
        drawn = command[0] in ("train", "self-play", "view", "render", "league")
        assert said.count(warning) == drawn, said
        assert page is None or text in (page / "report.html").read_text()
    assert (one / "results.json").exists() and (pair / "results.json").exists()


def test_runs_that_do_not_fit(
    runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before, out = content_of(runs), ["--out", tmp_path / "run", "--frames", "100"]
    of_doors = ["baseline", "--game", DOORS, "--player", "guard", "--opponent"]
    evaluate = ["evaluate", runs / "pair/first"]
    for arguments, message in (
        ([*of_doors, runs / "pair"], "a run of self-play without a player thief"),
        ([*of_doors, runs / "second"], "is a policy of second, not of thief"),
        ([*of_doors, tmp_path], "no run here"),
        (["train", "--game", "small_games:Nim(heap=8)", "--opponent", runs / "pair", *out],
         f"{runs / 'pair'}: this policy was trained in game {NIM!r} with 13 states"),
        (["evaluate", runs / "pair", "--opponent", "uniform"], "a whole run of self-play"),
        (["evaluate", runs / "pair", "--env", "pursuit_v5"], "env='pursuit_v5' has no effect"),
        (["evaluate", runs / "pair", "--teammates", "scripted"], "teammates='scripted' has no"),
        (["evaluate", runs / "pair", "--replays", "a.json"], "replays='a.json' has no effect"),
        ([*evaluate, "--replay-episodes", "3"], "replay_episodes=3 has no effect"),
        ([*evaluate, "--opponent", runs / "pair/first"], "is a policy of first, not of second"),
        ([*evaluate, "--opponent", "nosuch"], "'nosuch': not a policy"),
        ([*evaluate, "--maze", "5x5"], "not for task 'game'"),
        ([*evaluate, "--replays", tmp_path / "a.json"], "`pursuit view` shows episodes"),
        (["export", runs / "pair"], f"give {runs / 'pair/first'} or {runs / 'pair/second'}"),
        (["train", "--resume", runs / "pair"], "a run of kind 'self-play'"),
        (["self-play", "--resume", runs / "second"], "a run of kind 'single'"),
    ):  # fmt: skip
        assert message in error_of(capsys, *arguments)
    assert content_of(runs) == before and not (tmp_path / "run").exists()


def test_the_same_states_with_other_actions_are_another_game(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = ["train", "--game", DOORS, *TINY[:4], "--no-report", "--frames", "2048"]
    run(*given, "--algorithm", "q_learning", "--player", "thief", "--out", tmp_path / "thief")
    hop = ["baseline", "--game", "command_games:Hop", "--opponent", tmp_path / "thief"]
    assert "states or legal actions of 'command_games:Hop'" in error_of(capsys, *hop)


def test_damaged_runs(runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    def damage(name: str, path: str, change: Any) -> Path:
        folder = tmp_path / name
        shutil.copytree(runs / "pair", folder)
        content = (folder / path).read_bytes()
        (folder / path).write_bytes(change(content))
        return folder

    def edit(**changed: Any) -> Any:
        return lambda content: json.dumps({**json.loads(content), **changed}).encode()

    task = json.loads((runs / "pair/first/config.json").read_text())["task"]
    for number, (path, change, message) in enumerate(
        [
            ("first/checkpoint.pt", lambda content: content[: len(content) // 2], "checkpoint.pt"),
            ("first/checkpoint.pt", lambda content: b"", "checkpoint.pt"),
            ("first/config.json", edit(task={**task, "game": "small_games:Nim(heap=8)"}), "first"),
            ("first/config.json", edit(task={**task, "player": "third"}), "player 'third'"),
            ("first/config.json", edit(task={**task, "max_steps": "many"}), "max_steps='many'"),
            ("config.json", edit(players={"first": 3, "second": "uniform"}), "first=3"),
            ("config.json", edit(players={"first": "uniform"}), "give a table of first, second"),
            ("config.json", edit(players=[1]), "players"),
        ]
    ):
        folder = damage(str(number), path, change)
        before = content_of(folder)
        commands = [["evaluate", folder], ["evaluate", folder / "first"]]
        if path == "config.json":
            commands = [["evaluate", folder], ["self-play", "--resume", folder]]
        for command in commands:
            assert message in error_of(capsys, *command), (path, command)
        assert content_of(folder) == before


def test_a_side_without_its_run_needs_opponents(
    runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    shutil.copytree(runs / "pair/first", tmp_path / "lone")
    assert "give --opponent" in error_of(capsys, "evaluate", tmp_path / "lone")
    run("evaluate", tmp_path / "lone", "--opponent", "uniform")
    assert "with second uniform" in capsys.readouterr().out


# -- trust ---------------------------------------------------------------------------------------


def test_the_game_of_somebody_elses_run_is_imported_only_if_allowed(
    runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "_allowed", {"small_games"})
    monkeypatch.setattr(plugins, "_named", set())
    monkeypatch.delenv(plugins.ALLOW, raising=False)
    (tmp_path / "foreign_nim.py").write_text(
        "open('imported', 'w')\nfrom small_games import Nim\n"
        "def best(state):\n    return {None: 1.0} if state[1] == 0 else {1: 1.0}\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    folder, other = tmp_path / "run", tmp_path / "fixed"
    shutil.copytree(runs / "pair", folder)
    shutil.copytree(runs / "pair", other)
    for path in folder.rglob("config.json"):
        path.write_text(path.read_text().replace("small_games:", "foreign_nim:"))
    path = other / "config.json"
    config = json.loads(path.read_text())
    config["players"]["second"] = "foreign_nim:best"
    path.write_text(json.dumps(config))
    against = ["baseline", "--game", NIM, "--player", "first", "--opponent", other]
    for command in (
        ["evaluate", folder],
        ["evaluate", folder / "first"],
        ["export", folder / "first"],
        ["self-play", "--resume", folder],
        ["baseline", "--game", NIM, "--player", "first", "--opponent", folder],
        against,
    ):
        assert "add --allow foreign_nim" in error_of(capsys, *command)
        assert not (tmp_path / "imported").exists()
    run("evaluate", folder, "--allow", "foreign_nim")
    assert "NashConv" in capsys.readouterr().out and (tmp_path / "imported").exists()
    run(*against)
    assert "with second foreign_nim:best" in capsys.readouterr().out


def test_a_player_alone_has_no_opponents(capsys: pytest.CaptureFixture[str]) -> None:
    run("baseline", "--game", "command_games:Alone")
    assert "2 joint actions), alone, at most 200 steps" in capsys.readouterr().out
