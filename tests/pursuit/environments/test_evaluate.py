"""`pursuit.evaluate`: functions from observations to actions, compared with the exact optimum."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import pursuit
import train
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    TablePolicy,
    TourRunner,
    best_response,
)
from scripted_agents.environments import make_env, make_vector_env

CHASE: dict[str, Any] = {"maze": "3x3", "opponent_epsilon": 0.2}


@pytest.fixture(scope="module")
def evader(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The folder of a run of an evader, as a text."""
    folder = str(tmp_path_factory.mktemp("runs") / "evader")
    flat = {"role": "evader", "maze": "3x3", "frames": 512, "num_games": 16, "minibatch_size": 64}
    run = train.start("single", train.settings_of(**flat, threads=1), folder)
    run.train()
    run.results()
    return folder


class Learner:
    """A function of observations; positions are 1 + cell of the chaser and of the evader."""

    def __init__(self, policy: Any) -> None:
        maze = pursuit.load_maze("3x3")
        self.table = policy.action_probabilities(maze)
        self.shapes: set[tuple[int, ...]] = set()

    def __call__(self, seen: NDArray[Any]) -> NDArray[Any]:
        self.shapes.add(seen.shape)
        return self.table[seen[:, 0] - 1, np.maximum(seen[:, 1] - 1, 0)].argmax(axis=-1)


def test_a_function_is_played_and_compared_with_the_optimum() -> None:
    maze = pursuit.load_maze("3x3")
    evader = AStarEvader(0.2).action_probabilities(maze)
    best = TablePolicy(maze, best_response("chaser", maze, evader, horizon=200).policy)
    function = Learner(best)
    found = pursuit.evaluate(function, "chase", "chaser", "positions", episodes=4000, **CHASE)
    exact = pursuit.evaluate(best, "chase", "chaser", **CHASE)
    assert function.shapes == {(4000, 3)} and found.episodes == 4000
    assert exact.gap == pytest.approx(0.0, abs=1e-9) and exact.ci95 == 0.0
    assert found.gap is not None and found.gap_ci95 is not None
    assert abs(found.mean_steps - exact.mean_steps) < 2 * found.ci95
    low, high = found.gap_ci95
    assert low < found.gap < high and low - 0.01 < 0.0 < high + 0.01
    worse = pursuit.evaluate(Learner(AStarChaser()), "chase", observation="positions", **CHASE)
    assert worse.gap is not None and worse.gap > 0.5


def test_the_interval_of_the_gap_covers_as_often_as_it_says() -> None:
    def straight(seen: NDArray[Any]) -> NDArray[Any]:
        return seen[:, 0] % 4  # a poor policy with varying episode lengths

    game = {**CHASE, "observation": "positions", "max_steps": 30}
    exact = pursuit.evaluate(straight, "chase", episodes=40_000, seed=1000, **game).gap
    assert exact is not None
    inside = 0
    for seed in range(100):
        found = pursuit.evaluate(straight, "chase", episodes=200, seed=seed, **game).gap_ci95
        assert found is not None
        inside += found[0] <= exact <= found[1]
    assert 88 <= inside <= 99


def test_tours_arms_and_heists() -> None:
    task = pursuit.make_task("maze", maze="3x3", num_goals=2)
    tours = pursuit.evaluate(TourRunner(), task, episodes=300)
    assert tours.gap == 0.0 and tours.gap_ci95 == (0.0, 0.0) and tours.success_rate == 1.0
    still = pursuit.evaluate(lambda seen: np.zeros((len(seen), 2)), "reacher", episodes=20)
    assert still.gap is not None and still.gap > 1.0
    heist = pursuit.evaluate(
        lambda seen: np.zeros(len(seen), dtype=int), "heist", "evader", maze="3x3", num_goals=1,
        episodes=20,
    )  # fmt: skip
    assert heist.measure == "return" and heist.optimum is not None and heist.mean < heist.optimum
    race = pursuit.evaluate(NearestGoalRunner(), "race", maze="3x3", num_goals=2, episodes=300)
    assert race.measure == "goals" and race.optimum is not None
    assert 0.0 < race.mean <= race.optimum + 0.1


@pytest.mark.parametrize("wrong", [{}, [], False, 0, 0.0, "", b"one_hot"], ids=repr)
def test_only_none_is_the_default_observation(wrong: Any) -> None:
    def stay(seen: Any) -> Any:
        return np.zeros(len(seen), dtype=int)

    with pytest.raises(ValueError, match="observation"):
        pursuit.evaluate(stay, "chase", observation=wrong, episodes=2, **CHASE)
    with pytest.raises(ValueError, match="observation"):
        pursuit.evaluate(stay, "reacher", observation=wrong, episodes=2, joints=1)


def test_invalid_actions_are_refused() -> None:
    for function, said in (
        (lambda seen: np.zeros(3, dtype=int), r"shape \(3,\), dtype int64"),
        (lambda seen: np.zeros(len(seen)), "dtype float64; return integers"),
        (lambda seen: np.full(len(seen), 4), "from 4 to 4; return integers from 0 to 3"),
        (7, "policy=7; give a function"),
    ):
        with pytest.raises(ValueError, match=said):
            pursuit.evaluate(function, "chase", episodes=20, **CHASE)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="maze: settings of a new task"):
        pursuit.evaluate(AStarChaser(), pursuit.make_task("chase"), maze="3x3")


class Pairs:
    """Returns (actions, state), as `predict` of Stable-Baselines3."""

    def act(self, view: Any) -> Any:
        return np.zeros(view.num_games, dtype=np.int32), None


def test_policies_that_return_actions_and_a_state_are_refused() -> None:
    said = "the policy returned a tuple; return the actions alone"
    for policy, task, more in (
        (lambda seen: (np.zeros(len(seen), dtype=int), None), "chase", CHASE),
        (lambda seen: (0, None), "chase", CHASE),
        (lambda seen: (np.zeros((len(seen), 2)), None), "reacher", {}),
        (Pairs(), "chase", CHASE),
        (AStarChaser(), "chase", {**CHASE, "opponent": Pairs()}),
    ):
        with pytest.raises(ValueError, match=said):
            pursuit.evaluate(policy, task, episodes=20, **more)  # type: ignore[arg-type]
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3", opponent=Pairs())
    env.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        env.step(0)


def test_an_arm_has_no_optimum_where_only_a_bound_is_known() -> None:
    found = pursuit.evaluate(
        lambda seen: np.ones((len(seen), 2), dtype=int), "reacher", episodes=20,
        discrete_actions=True,
    )  # fmt: skip
    assert found.optimal_steps is None and found.gap is None and found.optimum is None
    assert found.mean == found.mean_steps > 1.0
    assert found.why_no_optimum == "discrete actions; only a lower bound of the steps is known"


def test_the_reason_is_given_where_no_optimum_is_known() -> None:
    found = pursuit.evaluate(AStarChaser(), "chase", episodes=20, view_radius=1, maze="3x3")
    assert found.optimum is None and found.why_no_optimum == "limited view"
    large = {"maze": "15x15", "num_chasers": 4, "num_evaders": 4}
    found = pursuit.evaluate(AStarChaser(), "chase", episodes=4, **large)
    assert found.optimum is None and "states" in str(found.why_no_optimum)
    known = pursuit.evaluate(AStarChaser(), "chase", episodes=20, maze="3x3")
    assert known.optimum is not None and known.why_no_optimum is None


@pytest.mark.parametrize(
    "given", [{"agent": "chaser"}, {"opponent": "astar"}, {"opponent_epsilon": 0.5}]
)
def test_settings_of_games_are_refused_for_an_arm(given: dict[str, Any]) -> None:
    name, value = next(iter(given.items()))
    with pytest.raises(ValueError, match=f"{name}={value!r}; "):
        pursuit.evaluate(lambda seen: np.zeros((len(seen), 2)), "reacher", episodes=20, **given)


def test_torch_is_needed_for_learned_opponents_only(tmp_path: Path) -> None:
    code = (
        "import pursuit, sys; sys.modules['torch'] = None\n"
        "first = lambda seen: seen[:, 0].astype(int) % 4\n"
        "print(pursuit.evaluate(first, 'chase', maze='3x3', episodes=9).episodes)\n"
        f"try: pursuit.evaluate(first, 'chase', opponent={str(tmp_path)!r})\n"
        "except ImportError as error: print(error)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("9\ntrain.runs.opponents:opponents_of needs torch, which is not")


def test_the_folder_of_a_run_is_an_opponent_in_gymnasium(evader: str) -> None:
    envs = [
        gymnasium.make("pursuit/Chaser-v0", maze="3x3", opponent=evader).unwrapped,
        make_env("chase", "chaser", maze="3x3", opponent=Path(evader)),
        gymnasium.make_vec("pursuit/Chaser-v0", 4, maze="3x3", opponent=evader),
        make_vector_env("chase", "chaser", 4, maze="3x3", opponent=Path(evader)),
    ]
    for env in envs:
        env.reset(seed=0)
        env.step(env.action_space.sample())
        assert env.policies[1].agent == "evader"
    found = pursuit.evaluate(AStarChaser(), "chase", maze="3x3", opponent=evader)
    assert found.gap is not None and found.gap > 0.0
    with pytest.raises(ValueError, match="is a policy for 'evader'"):
        gymnasium.make("pursuit/Evader-v0", maze="3x3", opponent=evader)
    with pytest.raises(ValueError, match="unknown policy 'runs/none'"):
        gymnasium.make("pursuit/Chaser-v0", maze="3x3", opponent="runs/none")


def test_paths_are_texts_too(evader: str) -> None:
    from train.experiments.rows import read_run
    from train.kinds import read_settings
    from train.runs.folder import load_checkpoint, read_metrics
    from train.runs.saved import load_settings

    run = train.open_run(evader)
    run.results()
    assert train.load_policy(evader).agent == "evader"
    for read in (read_settings, load_settings, load_checkpoint, read_metrics):
        assert read(evader)
    assert read_run(Path(evader))[0]["role"] == "evader"


def test_players_of_small_games_are_compared_with_their_best_response() -> None:
    task = pursuit.GameTask(pursuit.load_game("rock_paper_scissors(memory=False)"), "one", 1)
    first, second = task.agent_names
    always = pursuit.TableAgent(task, second, np.array([0.5, 0.25, 0.25]))
    mixed = pursuit.TableAgent(task, first, np.full(3, 1 / 3))
    exact = pursuit.evaluate(mixed, task, opponent=always)  # type: ignore[arg-type]
    assert (exact.measure, exact.mean, exact.ci95) == ("return", pytest.approx(0.0), 0.0)
    assert exact.optimum == pytest.approx(0.25) and exact.gap is None
    assert exact.mean_steps == 1.0 and exact.why_no_optimum is None
    shapes = set()

    def paper(seen: NDArray[Any]) -> NDArray[Any]:
        shapes.add(seen.shape)
        return np.full(len(seen), 1)

    found = pursuit.evaluate(paper, task, first, opponent=always, episodes=4000)
    assert shapes == {(4000, 1)} and found.mean == pytest.approx(0.25, abs=0.06)
    assert found.optimum == exact.optimum
    uniform = pursuit.evaluate(paper, task, second)
    assert uniform.optimum == pytest.approx(0.0)
    with pytest.raises(ValueError, match="from 0 to 2"):
        pursuit.evaluate(lambda seen: np.full(len(seen), 3), task)
    with pytest.raises(ValueError, match="need tables"):
        pursuit.evaluate(paper, task, opponent=Pairs())
