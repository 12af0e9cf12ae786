"""Runs in small games: against fixed opponents and by self-play, their files, and exact scores."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trained_games
from self_play_runs import tables_of

from scripted_agents.games.named import load_game
from scripted_agents.games.simulator import GameSimulator, GameTask
from train.algorithms.learner import no_actions
from train.commands.main import main
from train.files import Plain
from train.kinds import start
from train.runs.folder import CONFIG, RESULTS, RUN, SELF_PLAY, read_metrics
from train.runs.loop import Run
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.self_play.parts import self_play_settings_of
from train.settings.task import _game_with

pytestmark = [
    pytest.mark.filterwarnings(f"ignore:{what}:UserWarning")
    for what in ("frames=", "curriculum 'opponent-epsilon' goes from")
]
QUICK: Plain = {"num_games": 64, "minibatch_size": 512, "width": 32, "threads": 1}
STONES, THREE, CROWD, RPS = (
    f"trained_games:{name}"
    for name in ("Stones", "Stones(num_players=3)", "Crowd", "Matrix(name=rock_paper_scissors)")
)

RPS_FOREVER = "rock_paper_scissors(memory=False)"


def trained(folder: Path, **given: Any) -> Run[Any]:
    run = start(RUN, settings_of(**{**QUICK, "frames": 40_000, **given}), folder)
    run.train()
    return run


def played(folder: Path, **given: Any) -> Run[Any]:
    given = {"snapshots": 4, "frames": 10_000, **given}
    run = start(SELF_PLAY, self_play_settings_of(**{**QUICK, **given}), folder)
    run.train()
    return run


def simulated(task: GameTask, policies: Plain, episodes: int = 20_000) -> GameSimulator:
    """Games that are played to their end."""
    games = GameSimulator(task, episodes, seed=5, auto_restart=False)
    order = [policies[name] for name in task.agent_names]
    actions = np.zeros((episodes, task.num_agents), dtype=np.int32)
    while not games.ended.all():
        games.act(order, actions)
        games.step(actions)
    return games


def is_mean_of(exact: float, sample: Any) -> bool:
    """Within 4.5 standard errors; 7 of a million correct means are not."""
    return bool(abs(sample.mean() - exact) <= 4.5 * sample.std() / len(sample) ** 0.5 + 1e-12)


def pure_policies(game: Any, player: str) -> Iterator[Any]:
    """The tables of all deterministic policies of a player."""
    sizes = np.diff(game.offsets(game.player(player)))
    for chosen in product(*map(range, sizes)):
        yield np.concatenate([np.eye(size)[own] for size, own in zip(sizes, chosen, strict=True)])


def expected_returns(game: Any, tables: Any, discount: float = 1.0, steps: int = 200) -> Any:
    """[players]: the expected returns, by recursion over the rules of the game."""
    rules, known = game.source, dict[Any, Any]()

    def choices(state: Any) -> Iterator[tuple[float, Any]]:
        number, rows = game.number[state], []
        for seat, player in enumerate(game.players):
            own = slice(*game.offsets(seat)[number : number + 2])
            rows.append(zip(rules.legal_actions(state, seat), tables[player][own], strict=True))
        for joint in product(*rows):
            chance = float(np.prod([share for _, share in joint]))
            if chance:
                yield chance, tuple(action for action, _ in joint)

    def value(state: Any, left: int) -> Any:
        total = np.zeros(len(game.players))
        if not left:
            return total
        if (state, left) not in known:
            for chance, actions in choices(state):
                for share, after, paid, ended in rules.transitions(state, actions):
                    later = 0.0 if ended else discount * value(after, left - 1)
                    total = total + chance * share * (np.array(paid) + later)
            known[state, left] = total
        return known[state, left]

    return sum(chance * value(state, steps) for chance, state in rules.starts())


# -- one player against fixed opponents ------------------------------------------------------------


@pytest.mark.parametrize(
    ("game", "player", "opponent"),
    [
        (STONES, "b", "equilibrium"),
        (STONES, "a", "trained_games:take_one"),
        (THREE, "b", "uniform"),
        (CROWD, "c", "uniform"),
    ],
)
def test_a_learner_reaches_the_best_response_to_fixed_opponents(
    tmp_path: Path, game: str, player: str, opponent: str
) -> None:
    run = trained(tmp_path, game=game, player=player, opponent=opponent, entropy_coef=0.05)
    found = run.results(100)["evaluation"]
    assert abs(found["return_regret"]) < 1e-6
    assert found["return_gap"] == pytest.approx(0.0, abs=1e-6)
    task, seat = run.trainee.contest.task, run.trainee.contest.task.seat(player)
    others = {name: policy.table(task) for name, policy in run.trainee.contest.opponents.items()}
    best = max(
        expected_returns(task.game, {**others, player: own})[seat]
        for own in pure_policies(task.game, player)
    )
    assert found["optimal_return"] == pytest.approx(best, abs=1e-6)
    assert found["mean_return"] == pytest.approx(best, abs=1e-6)


def test_the_scores_of_a_policy_that_mixes_are_those_of_the_simulator(tmp_path: Path) -> None:
    given: Plain = {"opponent": "equilibrium", "opponent_epsilon": 0.3, "evaluate": "sampled"}
    run = trained(tmp_path, game=STONES, frames=3000, **given)
    contest, policy = run.trainee.contest, run.trainee.policy
    games = simulated(contest.task, {**contest.opponents, "a": policy})
    found = run.results(100)["evaluation"]
    assert games.returns[:, 0].std() > 0.5 and games.steps.std() > 0.5
    assert is_mean_of(found["mean_return"], games.returns[:, 0])
    assert is_mean_of(found["mean_steps"], games.steps)
    tables = {"a": policy.table(contest.task), "b": contest.tables["b"]}
    exact = expected_returns(contest.task.game, tables)
    assert found["mean_return"] == pytest.approx(exact[0], abs=1e-9)


@pytest.mark.parametrize("opponent", ["equilibrium", "run"])
def test_the_epsilon_of_a_curriculum_changes_what_opponents_play(
    tmp_path: Path, opponent: str
) -> None:
    """Returns of training episodes against the exact returns with this epsilon; the learner stays
    as it is."""
    if opponent == "run":
        opponent = str(tmp_path / "other")
        trained(tmp_path / "other", game=STONES, player="b")
    exact = {}
    for epsilon in (1.0, 0.0):
        run = trained(
            tmp_path / f"{epsilon}", game=STONES, opponent=opponent, frames=60_000, num_games=512,
            minibatch_size=8192, learning_rate=1e-12, curriculum="opponent-epsilon",
            easiest=epsilon, hardest=epsilon, observation="one_hot",
        )  # fmt: skip
        task, policy = run.trainee.contest.task, run.trainee.learner.policy(greedy=False)
        other = run.trainee.contest.opponents["b"].table(task)
        sizes = np.diff(task.game.offsets(1))
        mixed = (1.0 - epsilon) * other + epsilon / np.repeat(sizes, sizes)
        tables = {"a": policy.table(task), "b": mixed}
        exact[epsilon] = expected_returns(task.game, tables)[0]
        rows = [row for row in run.rows if "episode_return" in row][1:]
        episodes = np.array([row["episodes"] for row in rows])
        mean = float(np.average([row["episode_return"] for row in rows], weights=episodes))
        assert abs(mean - exact[epsilon]) < 4.5 / episodes.sum() ** 0.5
    assert exact[1.0] - exact[0.0] > 0.3


@pytest.mark.parametrize("play", [trained, played])
def test_learning_does_not_depend_on_the_unit_of_rewards(tmp_path: Path, play: Any) -> None:
    """Rewards 1024 times as large are the same after scaling, bit for bit."""
    states = []
    for prize in (1.0, 1024.0):
        game = f"trained_games:Stones(prize={prize})"
        run = play(tmp_path / str(prize), game=game, frames=4000)
        learned: Any = run.trainee.learned()
        states.append((learned.get("a") or learned["learner"])["network"])
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])


@pytest.mark.parametrize("discount", [1.0, 0.95])
def test_without_discount_nothing_is_worth_anything_after_the_time_limit(
    tmp_path: Path, discount: float
) -> None:
    """Of a game that goes on forever: the values of states in the last step are those of a step."""
    given = {"game": RPS_FOREVER, "max_steps": 1, "gamma": discount, "frames": 2000}
    for run in (
        trained(tmp_path / "one", **given, opponent="uniform"),
        played(tmp_path / "both", **given),
    ):
        env = (
            run.trainee.sides["player_0"].env if hasattr(run.trainee, "sides") else run.trainee.env
        )
        env.reset()
        stepped, _ = env.step_tensors(no_actions(env))
        assert bool(stepped["done"].all())
        assert bool(stepped["terminated"].all()) == (discount == 1.0)


# -- self-play -------------------------------------------------------------------------------------


@pytest.mark.parametrize("game", [CROWD, THREE, RPS])
def test_nash_conv_equals_brute_force_over_pure_policies(tmp_path: Path, game: str) -> None:
    """Three players and general sums as well; the returns are those of the simulator."""
    run = played(tmp_path, game=game, frames=4000)
    task, tables = run.trainee.game.task, tables_of(run)
    discount = run.trainee.parts.game.discount
    assert discount == (0.95 if game == CROWD else 1.0)
    returns = expected_returns(task.game, tables, discount)
    gains = {
        player: max(
            expected_returns(task.game, {**tables, player: own}, discount)[seat]
            for own in pure_policies(task.game, player)
        )
        - returns[seat]
        for seat, player in enumerate(task.agent_names)
    }
    found = run.results(100)["evaluation"]
    assert found["nash_conv"] == pytest.approx(sum(gains.values()), abs=1e-9)
    assert found["nash_conv"] > 0.01
    policies = {player: run.trainee.policy(player) for player in task.agent_names}
    sampled = simulated(task, policies).returns
    for seat, player in enumerate(task.agent_names):
        assert found[f"{player}_gain"] == pytest.approx(gains[player], abs=1e-9)
        assert found[f"{player}_return"] == pytest.approx(returns[seat], abs=1e-9)
        if discount == 1.0:
            assert is_mean_of(found[f"{player}_return"], sampled[:, seat])
    assert ("game_value" in found) == (game == RPS)


# -- files -----------------------------------------------------------------------------------------


def test_the_files_of_a_run_hold_what_the_reference_says(tmp_path: Path) -> None:
    main(["train", "--game", STONES, "--opponent", "uniform", "--frames", "4000", "--num-games",
          "64", "--minibatch-size", "512", "--no-report", "--out", str(tmp_path)])  # fmt: skip
    results = json.loads((tmp_path / RESULTS).read_text())
    config = json.loads((tmp_path / CONFIG).read_text())
    assert (results["task"], results["role"], results["maze"]) == ("game", "a", None)
    assert results["game"] == config["task"]["game"] == STONES
    assert len(config["parts"]["game"]["sha256"]) == 64
    assert results["objective"]["column"] == "mean_return"
    names = [score["name"] for score in results["scores"]]
    assert names == ["uniform", "equilibrium", "optimal return", "learned", "learned, sampled"]
    assert all(score["exact"] for score in results["scores"])
    last = read_metrics(tmp_path)[-1]
    for name in ("mean_return", "return_regret", "nash_conv", "mean_steps", "success_rate"):
        assert last[name] == results["evaluation"][name]


def test_the_files_of_self_play_hold_what_the_reference_says(tmp_path: Path) -> None:
    main(["self-play", "--game", CROWD, "--frames", "4000", "--num-games", "64",
          "--minibatch-size", "512", "--c", "uniform", "--b.algorithm", "mmd", "--no-report",
          "--out", str(tmp_path)])  # fmt: skip
    results = json.loads((tmp_path / RESULTS).read_text())
    config = json.loads((tmp_path / CONFIG).read_text())
    assert (results["task"], results["game"], results["maze"]) == ("game", CROWD, None)
    assert (results["players"], results["zero_sum"]) == (["a", "b", "c"], False)
    assert (results["states"], results["algorithm"]) == (2, "ppo, mmd")
    assert config["players"]["c"] == "uniform"
    assert config["players"]["b"]["algorithm"] == "mmd"
    last = read_metrics(tmp_path)[-1]
    for name in ("nash_conv", "a_return", "b_return", "c_gain", "a_vs_uniform", "steps"):
        assert last[name] == pytest.approx(results["evaluation"][name])
    assert not {"c_vs_uniform", "game_value", "value"} & set(last)
    kinds = {(row["player"], row["policy"], row["against"]) for row in results["returns"]}
    assert {("a", "learned", "uniform"), ("c", "frozen", "learned")} <= kinds
    assert {path.name for path in tmp_path.iterdir()} >= {"a", "b", "pool"}
    assert not (tmp_path / "c").exists()


def test_a_run_of_a_game_whose_states_come_in_another_order_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = trained(tmp_path / "run", game="trained_games:Chase", frames=1000)
    run.results(2)
    assert load_policy(tmp_path / "run").agent == "chaser"
    own = trained_games.Chase.starts
    monkeypatch.setattr(trained_games.Chase, "starts", lambda game: own(game)[::-1])
    for cached in (load_game, _game_with):
        cached.cache_clear()
    with pytest.raises(ValueError, match=r"in another order \(of a set"):
        load_policy(tmp_path / "run")
    for cached in (load_game, _game_with):
        cached.cache_clear()
