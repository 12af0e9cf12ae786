"""Training in tasks with options of the rules: discounts of turns, the axis slip, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from train.commands.main import main
from train.kinds import start
from train.runs.folder import RUN
from train.runs.parts import parts_of, settings_of
from train.runs.saved import load_settings
from train.runs.single import SingleAgent
from train.runs.training_state import build_env_and_learner

SMALL: dict[str, Any] = {
    "maze": "3x3", "frames": 4096, "num_games": 64, "minibatch_size": 512, "max_steps": 20,
}  # fmt: skip
TURNS: dict[str, Any] = {"move_order": "turns", "stay_action": True}


@pytest.mark.parametrize(("options", "steps"), [({}, 1), (TURNS, 2)])
def test_the_discount_is_that_of_a_round(options: dict[str, Any], steps: int) -> None:
    settings = settings_of(**SMALL, **options, gamma=0.81)
    _, _, learner = build_env_and_learner(parts_of(settings), None)
    assert learner.settings.gamma**steps == pytest.approx(0.81)  # type: ignore[attr-defined]
    assert settings.hyper.gamma == 0.81


def test_training_and_evaluation_in_turns_count_rounds(tmp_path: Path) -> None:
    run = start(RUN, settings_of(**SMALL, **TURNS), tmp_path)
    run.train()
    assert isinstance(run.trainee, SingleAgent)
    lengths = [row["episode_length"] for row in run.rows if "episode_length" in row]
    assert lengths and max(lengths) <= 20
    assert run.results(20)["evaluation"]["mean_steps"] <= 20


def test_results_of_tasks_with_exits_have_rates(tmp_path: Path) -> None:
    run = start(RUN, settings_of(**SMALL, task="escape"), tmp_path)
    run.train()
    content = run.results(20)
    found = content["evaluation"]
    assert content["objective"]["column"] == "outcome" and "outcome" in run.rows[-1]
    rates = [found[f"{name}_rate"] for name in ("capture", "escape", "timeout")]
    assert sum(rates) == pytest.approx(1.0) and found["outcome"] == pytest.approx(
        rates[0] - rates[1]
    )
    assert found["outcome_regret"] == pytest.approx(found["optimal_outcome"] - found["outcome"])
    assert content["reference"]["kind"] == "exact"


def test_the_axis_slip_scales_the_slips_of_all_agents() -> None:
    slip = "chaser=0.4,evader=0.1"
    settings = settings_of(**SMALL, slip=slip, curriculum="uniform", axis="slip", num_stages=3)
    env, teacher, _ = build_env_and_learner(parts_of(settings), None)
    env.reset_games()
    assert teacher is not None
    slips: Any = env.simulator.get_state()
    chances = slips.slip
    assert set(teacher.playing.tolist()) == {0.0, 0.2, 0.4}
    assert np.allclose(chances, teacher.playing[:, None] * [1.0, 0.25])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"curriculum": "slip"}, "needs slips"),
        ({"slip": "0.1", "curriculum": "slip", "hardest": 1.5}, "slip=1.5"),
        ({"task": "escape", "num_evaders": 2, "curriculum": "start-distance"}, "num_evaders=1"),
        ({"slip": "0.1", "curriculum": "level-replay"}, "exact optimum of every start"),
    ],
)
def test_curricula_that_cannot_be_exact_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        settings_of(**SMALL, **options)


@pytest.mark.parametrize("options", [{"task": "escape"}, TURNS])
def test_a_table_of_states_refuses_what_it_does_not_number(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="table over the cells"):
        settings_of(maze="3x3", frames=4096, num_games=64, algorithm="q_learning", **options)


def test_solve_refuses_turns(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["solve", "--maze", "3x3", "--move-order", "turns", "--stay-action"])
    assert ended.value.code == 2 and "move_order='turns'" in capsys.readouterr().err


def test_a_run_without_the_new_settings_is_read(tmp_path: Path) -> None:
    settings = settings_of(**SMALL)
    start(RUN, settings, tmp_path).train()
    path = tmp_path / "config.json"
    content = json.loads(path.read_text())
    for name in settings.task.ADDED:  # type: ignore[union-attr]
        del content["task"][name]
    path.write_text(json.dumps(content))
    assert load_settings(tmp_path) == settings
