"""Games by hand: every seat of every task, and a person's steps beside the optimum."""

from __future__ import annotations

import itertools
import os
import re
import shlex
import signal
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_errors import error_of
from played_by_hand import EAST, NORTH, SOUTH, STAY, WEST, Visitor, maze_session, serving

from pursuit.mazes.maze import Maze, load_maze
from pursuit.replays.replay import Replay
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner
from train.commands import play as play_command
from train.commands.main import main
from train.play.replay_folder import PATTERN, ReplayFolder
from train.play.server import PlayServer
from train.play.session import Session
from train.play.setup import session_of
from train.settings.task import TaskSettings

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "viewer.md"

# -- the optimum beside it, against solvers of our own ---------------------------------------------


def way(maze: Maze, start: int, end: int) -> list[int]:
    """The moves of a shortest path, by breadth first search."""
    before: dict[int, tuple[int, int]] = {start: (start, STAY)}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        for move in (NORTH, SOUTH, EAST, WEST):
            after = int(maze.neighbors[cell, move])
            if after not in before:
                before[after] = cell, move
                queue.append(after)
    moves = []
    while end != start:
        end, move = before[end]
        moves.append(move)
    return moves[::-1]


def tour(maze: Maze, start: int, goals: list[int]) -> list[int]:
    """The moves of a shortest tour, of all orders of the goals."""
    tours = []
    for order in itertools.permutations(goals):
        stops = [start, *order]
        tours.append([m for a, b in itertools.pairwise(stops) for m in way(maze, a, b)])
    return min(tours, key=len)


def least_steps_to_catch(maze: Maze, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """[chaser cell, evader cell] expected steps of the best chaser against a greedy A* evader, and
    its first move: backward induction, one state after the other."""
    table = AStarEvader(0.0).action_probabilities(maze)
    cells, next_of = range(maze.num_cells), maze.neighbors.tolist()
    values = np.zeros((maze.num_cells, maze.num_cells))
    moves = np.zeros(values.shape, dtype=int)
    for _ in range(horizon):
        later, values = values, np.zeros_like(values)
        for chaser, evader in itertools.product(cells, cells):
            if chaser == evader:
                continue
            costs = []
            for move in range(4):
                there, cost = next_of[chaser][move], 1.0
                for reply in range(4):
                    fled = next_of[evader][reply]
                    met = there == fled or (there == evader and fled == chaser)
                    if not met:
                        cost += table[evader, chaser, reply] * later[there, fled]
                costs.append(cost)
            values[chaser, evader], moves[chaser, evader] = min(costs), int(np.argmin(costs))
    return values, moves


# -- over HTTP -------------------------------------------------------------------------------------


@pytest.fixture
def runner() -> Iterator[tuple[Visitor, PlayServer]]:
    with serving(maze_session(7, "optimal", task="maze", maze="4x4", num_goals=3)) as both:
        yield both


def test_a_tour_played_by_hand_takes_the_least_steps_of_all_orders(
    runner: tuple[Visitor, PlayServer],
) -> None:
    visitor, _ = runner
    maze, state = load_maze("4x4"), visitor.state()
    assert state["board"]["walls"] == maze.to_text() and state["board"]["you"] == 0
    for game in range(3):
        assert (state["game"], state["step"], state["over"]) == (game, 0, False)
        (here,), goals = state["frame"]["cells"], state["frame"]["goals"]
        best = tour(maze, here, goals)
        for step, move in enumerate(best, start=1):
            here = int(maze.neighbors[here, move])
            state = visitor.move(move)
            assert state["frame"]["cells"] == [here] and state["step"] == step
        assert state["over"] and state["outcome"]["won"]
        assert state["outcome"]["optimal_steps"] == state["outcome"]["agent_steps"] == len(best)
        assert state["rows"][0] == ["you", f"{len(best)} steps, won"]
        assert state["rows"][1] == ["optimum", f"{len(best)} steps"]
        state = visitor.ask("POST", visitor.path + "next", {"game": game})[1]
    assert "3 games, 3 won" in state["total"]


def test_the_optimum_of_a_chase_is_the_value_of_its_start(
    chaser: tuple[Visitor, PlayServer],
) -> None:
    visitor, _ = chaser
    values, moves = least_steps_to_catch(load_maze("3x3"), 30)
    lengths, optima = [], []
    for game in range(25):
        state = visitor.state()
        start = tuple(state["frame"]["cells"])
        while not state["over"]:
            state = visitor.move(int(moves[tuple(state["frame"]["cells"])]))
        assert state["outcome"]["optimal_steps"] == pytest.approx(values[start], abs=1e-9)
        assert state["outcome"]["expected"]
        lengths.append(state["outcome"]["steps"])
        optima.append(state["outcome"]["optimal_steps"])
        visitor.ask("POST", visitor.path + "next", {"game": game})
    doubt = 4 * np.std(np.subtract(lengths, optima)) / len(lengths) ** 0.5 + 1e-9
    assert abs(np.mean(lengths) - np.mean(optima)) < doubt


def test_after_the_end_only_the_next_game_moves(runner: tuple[Visitor, PlayServer]) -> None:
    visitor, server = runner
    state = visitor.state()
    (here,), goals = state["frame"]["cells"], state["frame"]["goals"]
    for move in tour(load_maze("4x4"), here, goals):
        state = visitor.move(move)
    late = {"game": 0, "step": state["step"], "action": 0}
    assert visitor.ask("POST", visitor.path + "move", late)[0] == 409
    with pytest.raises(ValueError, match="game 0 is over; start the next game"):
        server.session.move(0)
    assert len(server.session.outcomes) == 1


# -- every seat ------------------------------------------------------------------------------------


def test_a_race_tells_who_has_collected_what() -> None:
    """A runner who goes for the nearest goal, as the agent beside does."""
    session = maze_session(4, task="race", maze="5x5", role="runner_1")
    policy = NearestGoalRunner(0.0)
    for _ in range(10):
        left = 3
        counts = [0, 0]
        while not session.over:
            session.move(int(policy.act(session.simulator.view("runner_1"))[0]))
            goals = sum(goal >= 0 for goal in session.frame()["goals"])
            for seat, paid in enumerate(session.rewards[-1]):
                counts[seat] += paid > 0
            assert left - goals <= sum(paid > 0 for paid in session.rewards[-1])
            left = goals
        outcome = session.outcomes[-1]
        assert outcome.collected == (("runner_1", counts[1]), ("runner_0", counts[0]))
        assert outcome.agent_goals == counts[1] and outcome.agent_steps == outcome.steps
        assert outcome.rows()[0] == ("you", f"{outcome.steps} steps, goals: {counts[1]}")
        session.next_game()


@pytest.mark.parametrize(
    ("task", "role", "known"),
    [
        ("chase", "chaser", True),
        ("chase", "evader", True),
        ("maze", "runner", True),
        ("race", "runner_1", False),
        ("heist", "chaser", False),
        ("heist", "evader", False),
    ],
)
def test_a_person_takes_any_seat(task: str, role: str, known: bool, tmp_path: Path) -> None:
    settings = TaskSettings(task=task, role=role, maze="4x4", stay_action=True, max_steps=40)
    session = session_of(settings, "astar", 1)
    keeper = ReplayFolder(tmp_path / "hand", "Ann")
    taken = []
    while not session.over:
        taken.append(session.step % 5)
        session.move(taken[-1])
    (outcome,) = session.outcomes
    assert (outcome.optimal_steps is not None) == known and outcome.steps == len(taken)
    assert ("not known" in "\n".join(outcome.lines())) != known
    assert 1 <= outcome.agent_steps <= 40
    keeper.keep(session)
    (kept,) = (tmp_path / "hand").glob(PATTERN)
    replay = Replay.load(kept)
    assert replay.check() == [] and replay.seed == 1 and kept.name == "game-0001.json"
    seat = session.task.seat(role)  # type: ignore[attr-defined]
    assert replay.episodes[0].actions[:, seat].tolist() == taken
    assert replay.players[replay.agents[seat]] == "Ann, by hand"


def test_a_captured_evader_is_over_for_the_person_alone(tmp_path: Path) -> None:
    settings = TaskSettings(maze="2x2", num_evaders=2, role="evader_1", opponent_epsilon=0.0)
    session = session_of(settings, "random", 0)
    keeper = ReplayFolder(tmp_path, "Ann")
    open_ends = 0
    for _ in range(20):
        while not session.over:
            session.move(NORTH)
        assert session.frame()["cells"][2] == -1 and not session.outcomes[-1].won
        open_ends += not session.simulator.ended[0]
        keeper.keep(session)
        session.next_game()
    assert 0 < open_ends < 20
    kept = list(tmp_path.glob(PATTERN))
    assert len(kept) == 20 and all(Replay.load(path).check() == [] for path in kept)


def test_the_agent_beside_plays_the_same_start_with_the_same_luck() -> None:
    """A person who moves as A* does ends as A* does, to the step."""
    session = maze_session(5, maze="5x5", role="chaser", opponent_epsilon=0.3)
    shadow = AStarChaser(0.0)
    for _ in range(20):
        while not session.over:
            session.move(int(shadow.act(session.simulator.view("chaser"))[0]))
        session.next_game()
    assert [o.steps for o in session.outcomes] == [o.agent_steps for o in session.outcomes]
    assert len({o.steps for o in session.outcomes}) > 5


# -- the command -----------------------------------------------------------------------------------


def test_the_command_serves_a_game_keeps_it_and_ends_by_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[str] = []
    prepared: list[Session] = []
    monkeypatch.setattr(Session, "optimum", lambda session, *_: prepared.append(session))

    def person() -> None:
        try:
            visitor = Visitor(seen[0])
            state = visitor.state()
            while not state["over"]:
                state = visitor.move(NORTH)
            seen.append(state["rows"][0][1])
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=person)

    def opened(address: str) -> bool:
        seen.append(address)
        assert prepared  # before the first move
        thread.start()
        return True

    monkeypatch.setattr(play_command, "open_page", opened)
    game = ["play", "--task", "heist", "--maze", "4x4", "--role", "evader", "--max-steps", "12"]
    main([*game, "--name", "Ann", "--out", str(tmp_path / "hand"), "--seed", "4"])
    thread.join(20)
    printed = capsys.readouterr().out
    assert f"preparing ...\nopened {seen[0]}" in printed and seen[1] in printed
    assert "optimum  not known" in printed and f"replays: {tmp_path / 'hand'}" in printed
    (kept,) = (tmp_path / "hand").glob(PATTERN)
    replay = Replay.load(kept)
    assert replay.check() == [] and replay.players["evader_0"] == "Ann, by hand"
    assert replay.seed == 2**62 + 4  # no game that anybody has learned from


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--role", "runner"], "does not exist in"),
        (["--against", "nobody"], "not a policy"),
        (["--beside", "nobody"], "not a policy"),
        (["--against", "astar", "--opponent", "random"], "give one"),
        (["--task", "maze", "--against", "random"], "has no other role"),
        (["--task", "heist", "--against", "optimal"], "3 goal(s)"),
        (["--task", "reacher"], "task='reacher' is not a game in mazes"),
        (["--port", "65536"], "port=65536"),
        (["--seed", "-1"], "seed=-1"),
        (["--name", " ", "--out", "x"], "name=' '"),
    ],
)
def test_wrong_command_lines_are_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in error_of(capsys, "play", "--no-browser", *arguments)


# -- the guide about it ----------------------------------------------------------------------------


def blocks_of(language: str) -> list[str]:
    text = GUIDE.read_text(encoding="utf-8").partition("\n## Play\n")[2]
    found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.M)
    return [code for named, code in found if named == language]


def test_the_commands_of_the_guide_run_as_they_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a player that always moves north."""
    monkeypatch.chdir(tmp_path)

    def go_north(session: Any, *rest: Any) -> None:
        while not session.over:
            session.move(NORTH)
        if rest[-1] is not None:
            rest[-1].keep(session)

    monkeypatch.setattr(play_command, "on_page", go_north)
    lines = [line for block in blocks_of("") for line in block.splitlines()]
    assert len(lines) >= 5 and all(line.startswith("pursuit ") for line in lines)
    for line in lines:
        main(shlex.split(line)[1:])
    printed = capsys.readouterr().out
    assert "you are evader on maze 9x9" in printed and "OptimalEvader(epsilon=0)" in printed
