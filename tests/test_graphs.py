"""Work captured once and replayed is the work itself, bit for bit; what cannot be is refused.

No GPU is needed: `graph_recorder` captures as a CUDA graph does, on the CPU.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import device_graphs
import device_learning
import numpy as np
import pytest
import torch
from device_graphs import REPLAYED, WARNED
from graph_recorder import Recorder, Refused
from numba import cuda
from test_gpu import simulated

from pursuit.simulator import Simulator
from pursuit.task import make_task
from scripted_agents import AStarEvader
from train.algorithms import dqn, ppo
from train.algorithms.graphs import MOST_NEW, PROTOTYPE, CudaGraphs, Inputs, Repeated, same, told
from train.algorithms.learner import Build
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import Seat
from train.runs.by_name import settings_of
from train.runs.parts import parts_of
from train.settings.algorithms import PPOSettings
from train.settings.off_policy import DQNSettings

pytestmark = pytest.mark.usefixtures("nothing_written_out")
WAITING = {
    "levels": "must know in every step",
    "value loss": "must know in every step",
    "uniform": "starts at some distance can be rare",
}
"""Cases whose rollouts cannot be captured, and why."""
PPO_CASES = [
    name
    for name, case in device_learning.CASES.items()
    if case.settings.get("algorithm", "ppo") == "ppo"
]
SELF_PLAY = [
    "pfsp with members",
    "window, small pool",
    "latest, bfloat16",
    "one network",
    "a network among tables",
]

# -- learning over games of a GPU ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "paused"),
    [
        (["opponent-epsilon"], True),
        (["a2c", "dqn on positions"], False),
        pytest.param(PPO_CASES, False, marks=pytest.mark.slow),
        pytest.param(SELF_PLAY, False, marks=pytest.mark.slow),
        pytest.param(["ppo", "a network", "num-goals"], True, marks=pytest.mark.slow),
        pytest.param(["a2c", "dqn on positions"], True, marks=pytest.mark.slow),
        pytest.param(["pfsp with members"], True, marks=pytest.mark.slow),
    ],
)
def test_what_is_learned_with_graphs_is_what_is_learned_without(
    names: list[str], paused: bool, tmp_path: Path
) -> None:
    """Weights, games and whatever else a checkpoint holds, with rates that are annealed; without
    graphs the games are those of the CPU. Each rollout is one graph, each update or gradient step
    another."""
    given = [device_learning.PAUSED, *names] if paused else names
    simulated("device_graphs.py", str(tmp_path / "learned.npz"), *given)
    learned = np.load(tmp_path / "learned.npz")
    for name in names:
        for key, array in device_graphs.learn(name, "cpu").items():
            since_saved = paused and key.endswith(": ends")  # of episodes, for the next evaluation
            assert since_saved or learned[key].tobytes() == array.tobytes(), key
        replays, told = learned[f"{name}: {REPLAYED}"], learned[f"{name}: {WARNED}"].tolist()
        if name in WAITING:
            assert len(replays) == 1 and len(told) == 1 and WAITING[name] in told[0]
        else:
            # Both sides of self-play, and both halves of what is paused, have two graphs or more;
            # of A2C rollouts alone are captured.
            assert not told and len(replays) >= 2 - (name == "a2c")
            assert max(replays) >= device_graphs.LONGER // 3


# -- learning over games of the CPU: the update alone is captured ----------------------------------


def learner_of(graphs: Any, **changes: Any) -> ppo.PPO:
    task = make_task("chase", maze="3x3", max_steps=8)
    games = Simulator(task, 6, seed=4, auto_restart=False)
    env = SimulatorEnv(games, Seat(task, "chaser_0"), [None, AStarEvader(0.3)])
    # 48 frames: three minibatches an epoch, and three frames that are left out.
    given: dict[str, Any] = {"num_games": 6, "rollout_steps": 8, "minibatch_size": 15, "width": 16}
    torch.manual_seed(1)
    return ppo.build(PPOSettings(**given | changes), env, Build(graphs=graphs))


@pytest.mark.parametrize(
    "changes",
    [{}, {"critic": False}, {"kl_target": 0.01}, {"shared": False}, {"recurrent": "gru"}],
)
def test_an_update_that_is_replayed_is_the_update(changes: dict[str, Any]) -> None:
    figures: list[list[dict[str, float]]] = []
    weights = []
    for graphs in (None, Recorder()):
        learner = learner_of(graphs, **changes)
        versions = []
        figures.append([])
        for number in range(5):
            figures[-1].append(learner.iterate(number / 5))
            versions.append(sum(one._version for one in learner.network.parameters()))
        weights.append(learner.state_dict())
        assert versions == sorted(set(versions))  # tables of a policy go by them
        learner.close()
        if graphs is not None:
            assert [one.replays for one in graphs.graphs] == [4]
    assert figures[0] == figures[1]
    assert device_learning.arrays_in(weights[0], "").keys() == (
        device_learning.arrays_in(weights[1], "").keys()
    )
    for key, array in device_learning.arrays_in(weights[0], "").items():
        assert array.tobytes() == device_learning.arrays_in(weights[1], "")[key].tobytes(), key


@pytest.mark.parametrize("changes", [{}, {"prioritized": True, "n_steps": 2}, {"dueling": True}])
def test_a_gradient_step_that_is_replayed_is_the_gradient_step(changes: dict[str, Any]) -> None:
    """With copies to the target network between the steps. What is observed is no "index", whose
    first layers are a kernel of their own on the CPU."""
    sizes: dict[str, Any] = {"num_games": 6, "rollout_steps": 8, "batch_size": 16, "width": 16}
    sizes |= {"buffer_size": 100, "learning_starts": 40, "target_update_interval": 3}
    task = make_task("chase", maze="3x3", max_steps=8)
    states = []
    for graphs in (None, Recorder()):
        games = Simulator(task, 6, seed=4, auto_restart=False)
        env = SimulatorEnv(games, Seat(task, "chaser_0", "positions"), [None, AStarEvader(0.3)])
        torch.manual_seed(1)
        settings = DQNSettings(**sizes | changes, gradient_steps=4)
        learner = dqn.build(settings, env, Build(graphs=graphs))
        figures = [learner.iterate(number / 5) for number in range(5)]
        state = device_learning.arrays_in(learner.state_dict(), "")
        states.append((figures, {key: array.tobytes() for key, array in state.items()}))
        if graphs is not None:
            assert [one.replays for one in graphs.graphs] == [4 * 5 - 1]
    assert states[0] == states[1]


def test_settings_that_change_are_never_those_of_a_capture() -> None:
    """A variant of PPO may change them from update to update (docs/own_parts.md)."""
    weights, graphs = [], Recorder()
    for how in (None, graphs):
        learner = learner_of(how)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            for number in range(MOST_NEW + 2):
                learner.settings = replace(learner.settings, clip=0.05 / (number + 1))
                learner.iterate(0.0)
        weights.append([one.detach() for one in learner.network.parameters()])
    assert all(map(torch.equal, *weights)) and graphs.graphs == []
    assert ["does not stay the same" in str(one.message) for one in told] == [True]


def test_a_learner_that_takes_a_state_back_is_captured_anew() -> None:
    graphs = Recorder()
    learner = learner_of(graphs)
    for number in range(3):
        learner.iterate(number / 9)
    learner.load_state_dict(deepcopy(learner.state_dict()))  # Adam's moments lie elsewhere now
    before = [one.clone() for one in learner.network.parameters()]
    for number in range(3, 6):
        learner.iterate(number / 9)
    assert [one.replays for one in graphs.graphs] == [2, 2]
    assert not any(map(torch.equal, before, learner.network.parameters()))


# -- what is refused -------------------------------------------------------------------------------

X = torch.arange(4.0)


def repeated(
    function: Callable[[], Any], graphs: Any = None, changes: tuple[torch.Tensor, ...] = ()
) -> Repeated:
    return Repeated("the work", function, lambda: changes, lambda: 0, graphs or Recorder())


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (lambda: {"x": X * X.sum().item()}, "item"),
        (lambda: {"x": X[X > 1.0]}, "by a mask"),
        (lambda: {"x": X.nonzero()}, "nonzero"),
        (lambda: {"x": X + torch.tensor(1.0)}, "lift_fresh"),
        (lambda: {"x": torch.from_numpy(X.numpy())}, "numpy"),
        (lambda: {"x": X if X.sum() > 0.0 else -X}, "__bool__"),
        (lambda: {"x": torch.rand(3, generator=torch.Generator())}, "generator"),
    ],
)
def test_work_that_cannot_be_captured_goes_on_without_and_says_why(
    function: Callable[[], Any], reason: str
) -> None:
    work = repeated(function)
    first = work()
    with pytest.warns(UserWarning, match=f"the work goes on without CUDA graphs: .*{reason}"):
        second = work()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        third = work()
    assert first["x"].shape == second["x"].shape == third["x"].shape
    assert work.refused is not None and work.replays == 0


class Waiting(Recorder):
    """One that finds that the work waits."""

    def run(self, function: Callable[[], Any]) -> tuple[Any, str | None]:
        return function(), "it waits for the GPU (here:1)"


class Wrong(Recorder):
    """One whose replays do something else."""

    def __init__(self, do: Callable[[torch.Tensor], object], into: torch.Tensor) -> None:
        super().__init__()
        self.do, self.into = do, into

    def capture(self, function: Callable[[], Any]) -> tuple[Callable[[], None], Any]:
        replay, found = super().capture(function)
        return lambda: (replay(), self.do(self.into))[0], found  # type: ignore[func-returns-value]


def test_work_that_waits_when_it_is_first_done_is_never_captured() -> None:
    graphs = Waiting()
    work = repeated(lambda: {"x": X + 1.0}, graphs)
    with pytest.warns(UserWarning, match=r"waits for the GPU \(here:1\)"):
        work()
    work()
    assert graphs.graphs == [] and work.refused is not None


@pytest.mark.parametrize(
    "do",
    [
        lambda weights: weights.add_(0.5),
        lambda weights: weights.zero_(),
        lambda weights: weights[0].fill_(float("nan")),
    ],
)
def test_a_graph_that_does_not_do_what_was_captured_is_not_used(do: Any) -> None:
    """Whoever asked has what the work itself does, from the same random numbers."""
    own, other = torch.ones(8), torch.ones(8)

    def change(weights: torch.Tensor) -> dict[str, torch.Tensor]:
        weights.add_(torch.rand(8))
        return {"sum": weights.sum()}

    state = torch.get_rng_state()
    expected = [change(other)["sum"].item() for _ in range(4)]
    torch.set_rng_state(state)
    work = repeated(lambda: change(own), Wrong(do, own), (own,))
    found = [work()["sum"].item()]
    with pytest.warns(UserWarning, match="a replay does not do what was captured"):
        found.append(work()["sum"].item())
    found += [work()["sum"].item() for _ in range(2)]
    assert found == expected and torch.equal(own, other)


def test_whole_numbers_and_numbers_that_are_none_are_compared_as_well() -> None:
    few = torch.zeros(200, dtype=torch.int64)
    old, nan = torch.zeros(4), torch.full((4,), float("nan"))
    one, other = few.clone(), few.clone()
    one[:3], other[:5] = 1, 1
    assert same([few], [few], [one]) and not same([few], [few], [other])
    assert same([old], [nan], [nan]) and not same([old], [old], [nan])
    assert same([old], [old + 1.0], [old + 1.05]) and not same([old], [old + 1.0], [old + 1.2])


def test_memory_that_does_not_stay_where_it_is_is_given_up() -> None:
    given, graphs = Inputs(), Recorder()
    work = Repeated(
        "the work",
        lambda: {"x": given.columns["x"] + 1.0},
        list,
        lambda: given.columns["x"].data_ptr(),
        graphs,
    )
    kept = []
    for rows in range(1, MOST_NEW):
        given.take({"x": torch.zeros(rows)})
        kept.append(given.columns["x"])
        assert work()["x"].tolist() == [1.0] * rows
    given.take({"x": torch.zeros(9)})
    with pytest.warns(UserWarning, match="does not stay the same"):
        work()
    assert graphs.graphs == []


def test_a_recorded_graph_must_not_outlive_what_it_reads() -> None:
    kept = {"x": torch.ones(3)}
    replay, found = Recorder().capture(lambda: {"y": kept["x"] * 2.0})
    replay()
    assert found["y"].tolist() == [2.0, 2.0, 2.0]
    kept.clear()
    with pytest.raises(AssertionError, match="nobody keeps"):
        replay()


def test_capturing_changes_nothing() -> None:
    weights, drawn = torch.ones(3), torch.get_rng_state()
    replay, found = Recorder().capture(lambda: {"x": weights.add_(torch.rand(3)) * 2.0})
    assert weights.tolist() == [1.0, 1.0, 1.0] and torch.equal(drawn, torch.get_rng_state())
    assert (found["x"] > 1e9).all()  # rubbish
    replay()
    assert torch.equal(found["x"], weights * 2.0) and (weights > 1.0).any()
    with pytest.raises(Refused):
        Recorder().capture(lambda: weights.tolist())


# -- torch's own graphs, with stand-ins for the card -----------------------------------------------


class Card:
    """Stands in for what `CudaGraphs` calls of torch.cuda, and notes it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, broken: bool = False) -> None:
        self.noted: list[str] = []
        self.mode, self.broken, self.capturing = 0, broken, False
        self.cached: bool | None = None
        for name in ("current_stream", "stream", "graph", "CUDAGraph", "default_generators"):
            monkeypatch.setattr(torch.cuda, name, getattr(self, name))
        monkeypatch.setattr(torch.cuda, "Stream", lambda device: self.current_stream("side"))
        monkeypatch.setattr(torch.cuda, "get_sync_debug_mode", lambda: self.mode)
        monkeypatch.setattr(torch.cuda, "set_sync_debug_mode", self.set_mode)
        monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
        monkeypatch.setattr(torch, "rand", self.rand)

    def set_mode(self, mode: Any) -> None:
        self.mode = mode
        warnings.warn(f"{PROTOTYPE} feature and does not yet detect all", stacklevel=1)

    def current_stream(self, name: Any) -> Any:
        wait = lambda other: self.noted.append(f"{name} waits")  # noqa: E731
        return SimpleNamespace(wait_stream=wait, name=name)

    @contextmanager
    def stream(self, stream: Any) -> Iterator[None]:
        self.noted.append(f"in {stream.name}")
        yield
        self.noted.append(f"out of {stream.name}")

    def CUDAGraph(self) -> Any:
        return SimpleNamespace(replay=lambda: self.noted.append("replay"))

    @contextmanager
    def graph(self, graph: Any, stream: Any) -> Iterator[None]:
        self.cached = torch.is_autocast_cache_enabled()
        self.capturing = True
        try:
            yield
        finally:
            if self.broken:
                raise RuntimeError("capture_end: operation failed due to a previous error")
            self.capturing = False

    def rand(self, count: int, device: Any) -> Any:
        if self.capturing:
            raise RuntimeError("Offset increment outside graph capture encountered unexpectedly.")
        return None

    @property
    def default_generators(self) -> Any:
        mend = lambda state: self.noted.append(f"generator is {state}")  # noqa: E731
        return [SimpleNamespace(clone_state=lambda: "new", graphsafe_set_state=mend)]


def test_a_card_is_asked_beforehand_what_would_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    card, graphs = Card(monkeypatch), CudaGraphs("cuda")

    def waits() -> int:
        assert card.mode == "warn"
        warnings.warn("called a synchronizing CUDA operation (Triggered ...)", stacklevel=1)
        warnings.warn("something else", stacklevel=1)
        return 3

    with pytest.warns(UserWarning) as told:
        found, reason = graphs.run(waits)
    assert [str(one.message) for one in told] == ["something else"]
    assert found == 3 and str(reason).startswith("it waits for the GPU (") and card.mode == 0
    assert card.noted[0] == "side waits" and card.noted[-1].endswith("waits")
    assert graphs.run(lambda: 4) == (4, None)


def test_a_capture_that_breaks_off_says_what_was_first_and_mends_the_generator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    card = Card(monkeypatch)
    replay, found = CudaGraphs("cuda").capture(lambda: "static")
    replay()
    assert found == "static" and card.noted == ["in side", "out of side", "replay"]
    assert card.cached is False and torch.is_autocast_cache_enabled()

    def broken() -> None:
        raise ValueError("not allowed")

    card = Card(monkeypatch, broken=True)
    graphs = CudaGraphs("cuda")
    with pytest.raises(RuntimeError, match="capture_end") as error:
        graphs.capture(broken)
    assert told(error.value) == "ValueError: not allowed"
    assert card.noted[-1] == "generator is new" and torch.is_autocast_cache_enabled()


@pytest.mark.skipif(
    not (torch.cuda.is_available() and cuda.is_available()), reason="no GPU for torch and Numba"
)
@pytest.mark.parametrize("name", ["ppo", "bfloat16", "opponent-epsilon", "a network", "dqn"])
def test_on_a_card_work_is_captured_and_learns_the_same(name: str) -> None:
    """Nobody has run this yet."""
    weights = []
    for graphs in (None, CudaGraphs("cuda")):
        trainee: Any = device_learning.trainee_of(name, "cuda", None, graphs)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*goes on without CUDA graphs")
            device_learning.go_on(trainee, range(6), 6)
        assert graphs is None or trainee.learner.repeated.replays >= 4
        weights.append([one.detach().cpu() for one in trainee.learner.network.parameters()])
        trainee.close()
    torch.testing.assert_close(*weights, rtol=1e-2, atol=1e-3)


# -- the setting -----------------------------------------------------------------------------------


def test_graphs_are_for_runs_on_a_gpu_unless_they_are_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)

    def graphs(**flat: Any) -> Any:
        flat = {"task": "chase", "frames": 10, "precision": "float32", **flat}
        return parts_of(settings_of(**flat)).build.graphs

    assert graphs() is None and graphs(device="cuda", graphs="off") is None
    assert isinstance(graphs(device="cuda"), CudaGraphs)
    with pytest.raises(ValueError, match="unknown graphs 'on'"):
        graphs(device="cuda", graphs="on")
