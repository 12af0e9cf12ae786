"""A kind of games of one's own, `docs/guides/examples/line_game.py`, by every command."""

from __future__ import annotations

import ast
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import train.families
from pursuit.plugins import allow
from pursuit.simulator.batch import Batch
from train.commands.main import main
from train.families import family_of
from train.kinds import resume, start
from train.runs.folder import RUN, SELF_PLAY
from train.runs.parts import contest_of, settings_of
from train.runs.worlds import task_world_of
from train.self_play.parts import game_of_all, self_play_settings_of

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "guides" / "examples"
TASK = "line_game:FAMILY"
QUICK: dict[str, Any] = {"task": TASK, "num_games": 32, "minibatch_size": 256, "max_steps": 8}
SHORT: dict[str, Any] = {**QUICK, "frames": 1024, "rollout_steps": 8}


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    allow("line_game")


def line() -> Any:
    return sys.modules["line_game"]


def settings(**own: Any) -> Any:
    return settings_of(**{**SHORT, **own}).task


def results_in(folder: Path) -> Any:
    return json.loads((folder / "results.json").read_text())


@pytest.mark.parametrize("algorithm", ["ppo", "ippo", "mappo", "dqn", "iql", "vdn", "qmix"])
@pytest.mark.parametrize("view", [1, 5])
def test_it_is_trained_evaluated_and_viewed(
    algorithm: str, view: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a solution, where all see everything, and without one."""
    given = ["--task", TASK, "--view", str(view), "--algorithm", algorithm, "--num-games", "32"]
    of_ppo = algorithm.endswith("ppo")
    batch = ["--minibatch-size" if of_ppo else "--learning-starts", "256"]
    run, again = tmp_path / "run", tmp_path / "again.json"
    main(["train", *given, *batch, "--frames", "4000", "--episodes", "400", "--out", str(run)])
    found = results_in(run)["evaluation"]
    main(["evaluate", str(run), "--episodes", "400", "--out", str(again)])
    assert json.loads(again.read_text())["evaluation"]["mean_return"] == found["mean_return"]
    said = capsys.readouterr().out
    assert ("optimal return" in said) == (view == 5)
    assert ("no exact optimum: agents see 1 cells far" in said) == (view == 1)
    if view == 5:
        assert found["exact"] and found["mean_return"] <= found["optimal_return"] + 1e-9
    main(["view", str(run), "--no-open"])
    assert "_H" in (run / "report.html").read_text()  # the board is text


@pytest.mark.parametrize("agent", ["seeker", "seeker_1", "hider"])
def test_its_best_responses_have_the_return_of_their_play(agent: str) -> None:
    """The solver against the simulator, and against all plans of a short game."""
    how = "ippo" if agent == "seeker" else "ppo"
    contest = contest_of(settings(role=agent, view=5, algorithm=how), 4000, team=how == "ippo")
    best = contest.optimum()
    assert best is not None and best.exact
    played = contest.score("best", contest.best_policy())
    assert played.mean_return == pytest.approx(best.mean_return, abs=2.5 * played.value_ci95)
    others = contest.score("random", contest.scripted())
    assert others.mean_return < best.mean_return
    imitated = task_world_of(settings(role=agent, view=5), how == "ippo").optimal_policy()
    assert np.array_equal(imitated.plan, contest.best_policy().plan)


def test_nash_conv_of_random_play_is_what_best_responses_gain() -> None:
    game = game_of_all(settings(view=5))
    random = {role: game.scripted(())["random", role] for role in game.roles}
    found = game.exact(random)  # type: ignore[attr-defined]
    assert found["seeker_return"] == -found["hider_return"]
    means, _ = game.sampled(random, 20_000, 2**62)  # type: ignore[attr-defined]
    assert means.mean(axis=0) == pytest.approx(
        [found["seeker_return"], found["hider_return"]], abs=0.03
    )
    assert found["nash_conv"] == pytest.approx(found["seeker_gain"] + found["hider_gain"])
    assert 0.0 < found["hider_gain"] < 2.0 and 0.0 < found["seeker_gain"] < 2.0


@pytest.mark.parametrize("view", [1, 5])
def test_it_plays_itself_and_enters_a_league(
    view: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [f"--task={TASK}", f"--view={view}", "--num-games=32", "--minibatch-size=256"]
    given.append("--best-response-seconds=0.01")
    main(["self-play", *given, "--frames=4000", "--sampling=pfsp", "--snapshots=3", "--out=pair"])
    found = results_in(Path("pair"))
    assert ("nash_conv" in found["evaluation"]) == (view == 5)
    assert ("not_exact" in found) == ("approximate_best_response" in found) == (view == 1)
    main(["evaluate", "pair"])
    main(["evaluate", "pair/hider", "--episodes=50"])
    main(["league", "pair", "random", "--games=20", "--out=league"])
    main(["view", "pair", "--no-open"])
    said = capsys.readouterr().out
    assert ("NashConv" in said) and ("No exact NashConv" in said) == (view == 1)
    assert "hider_0, with seeker_0 pair/seeker (sampled), seeker_1 pair/seeker (sampled)" in said
    league = json.loads(Path("league/league.json").read_text())
    assert np.shape(league["payoff"]) == (2, 2) and len(league["hider_ratings"]) == 2
    with pytest.raises(SystemExit):
        main(["self-play", *given, "--frames=4000", "--seeker=nobody"])
    assert "'nobody': not a policy; give one of random" in capsys.readouterr().err


def test_a_resumed_run_ends_as_one_without_a_stop(tmp_path: Path) -> None:
    for kind, of in (
        (RUN, settings_of(**SHORT, algorithm="ippo")),
        (SELF_PLAY, self_play_settings_of(**SHORT, sampling="uniform", snapshots=2)),
    ):
        whole = start(kind, of, tmp_path / f"{kind}-whole")
        whole.train()
        stopped = start(kind, of, tmp_path / f"{kind}-stopped")

        def stop(run: Any, row: Any) -> None:
            run.stopped = run.trainee.frames >= 512

        stopped.train(stop)
        stopped.save()
        stopped.lock.release()
        assert 512 <= stopped.trainee.frames < 1024
        again = resume(tmp_path / f"{kind}-stopped", kind)
        again.train()
        states = [each.trainee.state_dict() for each in (whole, again)]
        assert repr(states[0]) == repr(states[1])


def test_it_is_ablated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "line.toml"
    file.write_text(
        f"""title = "Level replay on a line"
control = "none"
variants = [
    {{ name = "none" }},
    {{ name = "replay", curriculum = "level-replay", level_score = "learnability" }},
]
[settings]
task = "{TASK}"
view = 5
num_games = 32
minibatch_size = 256
[short]
seeds = [0, 1]
settings = {{ frames = 1_024 }}
"""
    )
    main(["ablate", str(file), "--out", str(tmp_path / "out"), "--allow", "line_game"])
    assert "return regret" in (tmp_path / "out" / "report" / "report.md").read_text()
    text = file.read_text().replace("view = 5", "view = 1")
    file.write_text(text)
    with pytest.raises(SystemExit):
        main(["ablate", str(file), "--out", str(tmp_path / "hidden")])
    assert "agents see 1 cells far" in capsys.readouterr().err


def test_what_it_does_not_have_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    for more, message in (
        (["--recurrent", "gru"], "memory"),
        (["--frame-stack", "2"], "policies have no memory"),
        (["--algorithm", "q_learning"], "table over the cells of a maze"),
        (["--curriculum", "goal-spread-start"], "games in mazes"),
        (["--opponent", "model.zip"], "'model.zip': not a policy; give one of"),
        (["--role", "nobody"], "nobody"),
        (["--observation", "one_hot"], "observe"),
        (["--algorithm", "mappo", "--critic-observation", "walls"], "use state"),
        (["--algorithm", "ippo", "--sharing", "joint"], "sharing='joint' does not support"),
    ):
        with pytest.raises(SystemExit):
            main(["train", "--task", TASK, "--frames", "512", *more])
        error = capsys.readouterr().err
        assert message in error and error.count("error:") == 1 and "Traceback" not in error


def test_it_can_be_registered_under_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    task_world_of(settings())  # loads it
    name = "line_of_tests"
    train.families.register(name, line().FAMILY)
    assert family_of(settings_of(**{**SHORT, "task": name}).task) is line().FAMILY
    with pytest.raises(ValueError, match="line_of_tests"):
        train.families.register(name, line().FAMILY)


def test_files_cannot_name_a_kind_of_games_of_a_module_that_is_not_allowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("stranger.py").write_text("open('trap', 'w').close()")
    monkeypatch.syspath_prepend(str(tmp_path))
    run = start(RUN, settings_of(**SHORT), "run")
    run.train()
    run.results(10)
    start(SELF_PLAY, self_play_settings_of(**SHORT, snapshots=2), "pair").train()
    assert json.loads(Path("run/config.json").read_text())["parts"]["task"]["name"] == TASK
    for path in (Path("run"), Path("pair"), Path("pair/hider")):
        config = path / "config.json"
        config.write_text(config.read_text().replace("line_game:", "stranger:"))
    Path("sweep.toml").write_text('title = "a"\n[settings]\ntask = "stranger:FAMILY"\n')
    for command in (
        *("evaluate run", "evaluate pair", "evaluate pair/hider", "league pair", "view run"),
        *("train --resume run", "self-play --resume pair", "render run", "sweep sweep.toml"),
    ):
        with pytest.raises(SystemExit):
            main(command.split())
        assert "stranger" in capsys.readouterr().err
    assert not Path("trap").exists() and "stranger" not in sys.modules


def test_the_example_is_short() -> None:
    text = (EXAMPLES / "line_game.py").read_text()
    assert sum(map(bool, map(str.strip, text.splitlines()))) <= 200


KINDS = re.compile(
    r"^(GameTask|ReacherTask|Task|SmallGameSettings|ReacherSettings|TaskSettings|Simulator"
    r"|GameSimulator|ReacherSimulator|\w*(Contest|Sides|World|Context|View|Seat|SelfPlay"
    r"|SelfPlaySettings))$"
)
"""Names of classes that are those of one kind of games."""
ALLOWED = {"train/families"}
CHECKS = {
    "pursuit/tasks/task.py": "an argument of the user",
    "pursuit/reacher/simulator.py": "an argument of the user",
    "scripted_agents/games/simulator.py": "an argument of the user",
    "scripted_agents/games/interface.py": "an argument of the user: a game, or its task",
    "scripted_agents/exact/references.py": "a policy of another library that has a task",
    "pursuit/replays/adapters.py": "replays of simulators by their class",
}


def test_no_kind_of_games_is_tested_outside_the_families() -> None:
    """`isinstance` and `is` with a class of one kind of games."""
    found = []
    for folder in ("train", "pursuit", "scripted_agents", "curricula"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            place = str(path.relative_to(ROOT))
            if place in CHECKS or any(place.startswith(each) for each in ALLOWED):
                continue
            for node in ast.walk(ast.parse(path.read_text())):
                tested: list[ast.expr] = []
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
                    tested = [node.args[1]]
                elif isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Is | ast.Eq):
                    tested = node.comparators
                names = {n.id for part in tested for n in ast.walk(part) if isinstance(n, ast.Name)}
                found += [f"{place}:{node.lineno} {n}" for n in names if KINDS.match(n)]  # type: ignore[attr-defined]
    assert not found, "; ".join(found)


def test_a_batch_of_ones_own_is_a_batch() -> None:
    batch: Batch[Any] = line().LineBatch(settings().build(), 3, seed=4)
    batch.step(np.ones((3, 3), dtype=np.int32))
    state = batch.get_state()
    batch.step(np.ones((3, 3), dtype=np.int32))
    batch.set_state(state)
    assert batch.steps.tolist() == [1, 1, 1] and "_" in batch.text(0)
