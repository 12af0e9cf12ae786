"""Learning from games on a GPU, without one: it is learning from games on the CPU, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import device_learning
import device_self_play
import numpy as np
import pytest
import torch
from numba import cuda
from test_gpu import simulated
from torch._subclasses.fake_tensor import FakeTensorMode

from pursuit.simulator import Simulator
from pursuit.task import make_task
from scripted_agents import AStarEvader
from train.algorithms import ppo
from train.algorithms.learner import Build
from train.algorithms.ppo import network_of
from train.environments.device_policies import check_plays
from train.environments.hooks import EpisodeHook
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import Seat
from train.runs.threads import uses_bfloat16
from train.self_play.parts import self_play_parts
from train.self_play.trainee import make_self_play
from train.settings.algorithms import PPOSettings
from train.settings.curricula import ScheduleSettings, UniformSettings
from train.settings.self_play import SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings
from train.teaching.axes import Ground, axis_of
from train.teaching.axis import Axis
from train.teaching.plan import Plan
from train.teaching.teacher import Judge, Teacher

pytestmark = pytest.mark.usefixtures("nothing_written_out")


def parts(quick: str, cases: Any, resumed: tuple[str, ...]) -> Any:
    """One case that is quick enough for every day, saved half-way; the others, all of them without
    an interruption and some of them with one, are slow."""
    slow = [pytest.param(list(cases), False), pytest.param(list(resumed), True)]
    marked = [pytest.param(*each.values, marks=pytest.mark.slow) for each in slow]
    return pytest.mark.parametrize(("names", "paused"), [([quick], True), *marked])


def check_learned(script: Any, names: list[str], paused: bool, folder: Path) -> None:
    """What is learned in the simulator of a GPU, in one go or from a checkpoint on, is what is
    learned on the CPU in one go, bit for bit."""
    given = [device_learning.PAUSED, *names] if paused else names
    simulated(f"{script.__name__}.py", str(folder / "learned.npz"), *given)
    learned = np.load(folder / "learned.npz")
    expected = {key: array for name in names for key, array in script.learn(name, "cpu").items()}
    assert set(learned.files) == set(expected)
    for key, array in expected.items():
        since_saved = paused and key.endswith(": ends")  # of episodes, for the next evaluation
        assert since_saved or learned[key].tobytes() == array.tobytes(), key


@parts(
    "goal-spread",
    device_learning.CASES,
    ("num-goals", "levels", "a network", "dqn, opponent-epsilon"),
)
def test_learners_and_teachers_are_the_same_with_games_of_a_gpu(
    names: list[str], paused: bool, tmp_path: Path
) -> None:
    """All weights, games, lessons and whatever else a checkpoint holds."""
    check_learned(device_learning, names, paused, tmp_path)


@parts("pfsp with members", device_self_play.CASES, ("window, small pool", "one network"))
def test_self_play_is_the_same_with_games_of_a_gpu(
    names: list[str], paused: bool, tmp_path: Path
) -> None:
    """Weights of both sides, who is in the pools, with what scores, and who plays in each game."""
    check_learned(device_self_play, names, paused, tmp_path)


# -- precision -------------------------------------------------------------------------------------


class Entered:
    """Stands before torch.autocast, and notes how it is entered."""

    def __init__(self) -> None:
        self.real: Any = torch.autocast
        self.noted: list[tuple[str, torch.dtype, bool]] = []

    def __call__(self, device_type: str, dtype: torch.dtype, enabled: bool = True) -> Any:
        self.noted.append((device_type, dtype, enabled))
        # There is no GPU to enter it for.
        return self.real("cpu", dtype, enabled=enabled and device_type == "cpu")


def test_autocast_is_entered_for_the_device_of_the_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    entered = Entered()
    monkeypatch.setattr(torch, "autocast", entered)
    seat = Seat(make_task("chase", maze="3x3"), "chaser_0")
    for bfloat16 in (True, False):
        trunk = network_of(PPOSettings(width=8), seat, Build(bfloat16=bfloat16)).policy_trunk
        trunk.first.forward = lambda prepared: torch.zeros(2, 8)  # type: ignore[method-assign]
        with FakeTensorMode():  # tensors without content, on devices that need not be there
            prepared = torch.empty(2, 5, device="cuda")
        trunk(prepared)
        assert entered.noted.pop() == ("cuda", torch.bfloat16, bfloat16)


def test_rollouts_and_updates_are_in_bfloat16_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    entered, settings = Entered(), PPOSettings(num_games=4, rollout_steps=3, minibatch_size=6)
    task = make_task("chase", maze="3x3")
    games = Simulator(task, 4, auto_restart=False)
    env = SimulatorEnv(games, Seat(task, "chaser_0"), [None, AStarEvader()])
    learner = ppo.build(settings, env, Build(bfloat16=True))
    monkeypatch.setattr(torch, "autocast", entered)
    entered.noted.clear()
    learner.iterate(0.0)
    learner.close()
    steps, updates = settings.rollout_steps, 2 * settings.epochs
    trunks = 1 if settings.shared else 2
    # Beside them at most one pass for the values of last observations.
    assert len(entered.noted) in (trunks * (steps + updates), trunks * (steps + updates + 1))
    assert set(entered.noted) == {("cpu", torch.bfloat16, True)}


def test_auto_takes_bfloat16_on_cards_that_have_it_in_hardware(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[bool] = []

    def supported(including_emulation: bool = True) -> bool:
        asked.append(including_emulation)
        return including_emulation

    monkeypatch.setattr(torch.cuda, "is_bf16_supported", supported)
    assert not uses_bfloat16("auto", "cuda") and asked == [False]
    assert uses_bfloat16("bfloat16", "cuda") and not uses_bfloat16("float32", "cuda:1")


# -- what is refused -------------------------------------------------------------------------------


class Placing(Axis):
    """An axis that does what games on a GPU cannot be told beforehand."""

    def __init__(self) -> None:
        super().__init__("placing", 0.0, 3.0, lambda games, chosen, values: games.place([0, 1]))


def test_lessons_that_only_games_on_the_cpu_can_be_given_say_so() -> None:
    task = make_task("chase", maze="3x3")
    judge = Judge(lambda games: games.terminated, lambda games: games.returns[:, 0])
    lessons = ScheduleSettings()

    def reason(axis: Axis) -> str | None:
        plan = Plan("start-distance", lessons, axis, task, None, 0)
        return Teacher(plan, Simulator(task, 2, auto_restart=False), judge).why_not_foretold()

    assert "more to games than to `configure` them" in str(reason(Placing()))
    turned = axis_of("start-distance", Ground(task, "chaser"), lessons)
    assert reason(turned) is None
    with pytest.raises(NotImplementedError, match="only the CPU can do"):
        EpisodeHook().foretell(1)


def test_a_teacher_whose_lessons_are_not_those_it_foretold_stops() -> None:
    task = make_task("chase", maze="3x3")
    judge = Judge(lambda games: games.terminated, lambda games: games.returns[:, 0])
    axis = axis_of("start-distance", Ground(task, "chaser"), ScheduleSettings())
    plan = Plan("uniform", UniformSettings(), axis, task, None, 0)
    teacher = Teacher(plan, Simulator(task, 4, auto_restart=False), judge)
    told = teacher.foretell(8).rows
    assert told is not None and len(told) == 8 and len(set(told.tolist())) > 1
    teacher.before_restart(np.arange(3))
    teacher.before_restart(np.array([1]))
    np.testing.assert_array_equal(teacher.foretell(4).rows, told[4:])
    teacher.rng.random(1)
    with pytest.raises(RuntimeError, match="`in_order`"):
        teacher.before_restart(np.arange(4))


def test_networks_that_cannot_be_asked_on_a_gpu_say_why() -> None:
    task = make_task("chase", maze="3x3")
    hyper = PPOSettings(width=8)

    def reason(**seat: Any) -> str:
        played = Seat(make_task("chase", maze=seat.pop("maze", "3x3")), "evader", **seat)
        policy = played.policy(network_of(hyper, played, Build()))
        with pytest.raises(ValueError) as error:
            check_plays([None, policy], task)
        return str(error.value)

    assert "masks of moves" in reason(mask_bumps=True)
    assert "does not play on a GPU" in reason(frame_stack=2)
    assert "in mazes of 25 cells; these games" in reason(maze="5x5")
    own = Seat(task, "evader")
    check_plays([None, own.policy(network_of(hyper, own, Build()))], task)


@pytest.mark.filterwarnings("ignore:the evader's games stay")
def test_self_play_says_why_its_games_stay_on_the_cpu(tmp_path: Path) -> None:
    if cuda.is_available():
        pytest.skip("there is a GPU")
    hyper = replace(self_play_ppo(), num_games=8, minibatch_size=16)
    task, more = TaskSettings(maze="3x3", rewards="zero_sum"), {"frames": 10, "device": "cuda"}
    settings = SelfPlaySettings(task, hyper, **more)  # type: ignore[arg-type]
    with pytest.warns(UserWarning, match=r"chaser's games stay on the CPU: .* no GPU here"):
        assert self_play_parts(settings).sides["chaser"].device == "cpu"
    team = replace(settings, task=replace(task, num_chasers=2))
    with pytest.warns(UserWarning, match="games stay on the CPU: 2 chasers learn at once"):
        self_play_parts(team)
    with pytest.raises(ValueError, match="torch finds no GPU here; use --device cpu"):
        make_self_play(settings, tmp_path)
    with pytest.raises(ValueError, match="what a GPU computes is not counted"):
        replace(settings, clock="processor", frames=None, seconds=1.0)
