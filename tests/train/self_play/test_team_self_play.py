"""Self-play of teams, also with limited views and memory, ends with the results of the teams."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from self_play_runs import go_on, make_run

from scripted_agents import solve_joint
from train.commands.main import main
from train.evaluation.self_play_text import describe_exploitability
from train.evaluation.team_contest import TeamContest, describe_team
from train.files import read_json
from train.runs.folder import read_metrics
from train.runs.loop import Run
from train.runs.opponents import load_policy
from train.settings.self_play import self_play_ppo

PPO = replace(
    self_play_ppo(), num_games=48, rollout_steps=8, minibatch_size=96, width=8, learning_rate=3e-3
)


def tiny(folder: Path, recurrent: str | None, **task: int) -> Run:
    hyper = replace(PPO, recurrent=recurrent)
    game = {"max_steps": 20, "view_radius": "1", "maze": "3x3", **task}
    return make_run(
        folder, task=game, hyper=hyper, frames=3000, best_response_seconds=0.0, episode_steps=9
    )


def weights(run: Run) -> list[torch.Tensor]:
    sides = run.trainee.sides.values()
    return [tensor for side in sides for tensor in side.learner.state_dict()["network"].values()]


@pytest.mark.parametrize(
    ("chasers", "evaders", "recurrent"),
    [
        (2, 1, None),
        (2, 2, "gru"),
        pytest.param(4, 1, "gru", marks=pytest.mark.slow),
    ],
)
def test_teams_with_limited_views_end_with_results(
    chasers: int, evaders: int, recurrent: str | None, tmp_path: Path
) -> None:
    run = tiny(tmp_path, recurrent, num_chasers=chasers, num_evaders=evaders)
    run.train()
    content = run.results(8)
    assert all(tensor.isfinite().all() for tensor in weights(run))
    rows = read_metrics(tmp_path)[1:]
    assert rows and all(np.isfinite([*row.values()]).all() for row in rows)
    sizes = {"chaser": chasers, "evader": evaders}
    assert {role: own["size"] for role, own in content["team"].items()} == {
        role: size for role, size in sizes.items() if size > 1
    }
    told = "\n".join(describe_exploitability(content))
    for found in content["team"].values():
        assert describe_team(found)[0][1:] in told and found["full_view"]
        assert (found["best_response"] is None) == (recurrent is not None)
        if recurrent is not None:
            assert "RecurrentPolicy of" in found["reason"] and not found["exact"]
            assert "Best known with these views" in told
    if recurrent is None:
        found, task = content["team"]["chaser"], run.trainee.game.task
        pair = {role: run.trainee.policy(role) for role in sizes}
        assert found["steps"] == pytest.approx(content["evaluation"]["steps"])
        assert found["best_response"] == content["exact_best_response"]["against_evader"]
        contest = TeamContest(task, "chaser", {"evader": pair["evader"]})
        assert contest.best == pytest.approx(found["best_response"])
        alone = solve_joint(task, "chaser_1", pair, 20).mean_over_starts
        assert found["members"]["chaser_1"]["best_response"] == pytest.approx(alone)
        assert found["interval"]["bound"] <= found["interval"]["achieved"] <= found["steps"]


@pytest.mark.slow
def test_a_stopped_team_with_memory_resumes(tmp_path: Path) -> None:
    whole = tiny(tmp_path / "whole", "gru", num_chasers=2, num_evaders=2)
    whole.train()
    half = tiny(tmp_path / "half", "gru", num_chasers=2, num_evaders=2)

    def stop(run: Run, row: dict[str, float]) -> None:
        run.stopped = run.progress > 0.4

    half.train(stop)
    assert half.stopped and half.results(4)["team"]["evader"]["size"] == 2
    rest = go_on(tmp_path / "half")
    rest.train()
    assert rest.results(4)["team"].keys() == {"chaser", "evader"}
    for one, two in zip(weights(whole), weights(rest), strict=True):
        assert torch.equal(one, two)


def test_commands_play_the_learned_team(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pair, out = tmp_path / "pair", tmp_path / "out.json"
    small = ["--num-games", "16", "--rollout-steps", "4", "--minibatch-size", "16", "--width", "8"]
    game = ["--maze", "3x3", "--num-chasers", "2", "--max-steps", "9", "--frames", "100"]
    seen = ["--view-radius", "1", "--episodes", "4", "--no-report", "--out", str(pair)]
    main(["self-play", *game, *small, *seen])
    said = capsys.readouterr().out
    assert "Team of 2 chasers: " in said and "The optimum of a team with these views" in said
    chaser = str(pair / "chaser")
    main(["evaluate", chaser, "--episodes", "4", "--out", str(out)])
    said, found = capsys.readouterr().out, json.loads(out.read_text())["team"]
    assert "team of 2 chasers on maze 3x3" in said.splitlines()[0]
    assert all(line in said for line in describe_team(found))
    policy: Any = load_policy(chaser)
    contest = TeamContest(policy.task, "chaser", {"evader": load_policy(pair / "evader")})
    own = json.loads(out.read_text())["evaluation"]
    assert found["steps"] == own["mean_steps"] and found["exact"]
    with pytest.raises(SystemExit):
        main(["evaluate", str(pair / "evader"), "--teammates", "learned"])
    assert "trained one agent" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["evaluate", chaser, "--opponent", chaser])
    assert "the whole team is evaluated" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["evaluate", chaser, "--maze", "suite:5x5-test"])
    main(
        ["league", str(pair), "searching", "--games", "4", "--greedy", "--out", str(tmp_path / "l")]
    )
    said, rows = capsys.readouterr().out, read_json(tmp_path / "l" / "league.json")["team"]
    known = {(row["team"], row["against"]): row for row in rows}
    assert len(known) == 4 and "best team response, full view" in said
    against = known["pair", "pair"]
    assert against["best_response"] == pytest.approx(contest.best)
    assert against["payoff"] == pytest.approx(contest.value_of(policy))
    assert against["gap"] == pytest.approx(against["payoff"] / against["best_response"] - 1.0)
    assert known["pair", "searching"]["best_response"] is None
    assert "no exact best response of the chasers against searching: WaryEvader" in said
    main(["render", chaser, "--episodes", "1", "--out", str(tmp_path / "team.gif")])
    main(["view", chaser, "--no-open", "--out", str(tmp_path / "team.html")])
