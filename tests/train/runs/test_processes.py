"""Data parallel training in several processes: results, resumption, and exits."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_resumption import CHASER, KilledError, check_resumption, kill, tiny
from waiting import PATIENCE, wait_until

from train.algorithms.learner import clip_gradients
from train.algorithms.ppo import PPO
from train.algorithms.rollouts import select
from train.experiments.identity import fingerprint
from train.kinds import open_run, start
from train.networks.fused_actor_critic import LossCoefficients
from train.runs.data_parallel import ProcessEnded, weights_digest
from train.runs.folder import CHECKPOINT, RUN, load_checkpoint, save_checkpoint
from train.runs.interruption import Diverged
from train.runs.loop import Run
from train.runs.parts import parts_of, settings_of
from train.runs.single import SingleAgent
from train.runs.threads import prepare_torch
from train.runs.training_state import build_env_and_learner, simulator_tensors
from train.self_play.parts import self_play_settings_of

RUNNER = {"task": "maze", "maze": "3x3", "num_goals": 2, "max_steps": 12}
TWO = {**RUNNER, "processes": 2}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other processes are forked, which is fast; only the last tests spawn them."""
    monkeypatch.setattr("train.runs.data_parallel.can_fork", lambda: True)
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 4)
    monkeypatch.setattr("train.runs.single.EPISODES", 10)


def weights_of(run: Run) -> list[torch.Tensor]:
    return [weight.detach().clone() for weight in run.trainee.learner.network.parameters()]


# -- results ---------------------------------------------------------------------------------------


def plainly(settings: Any) -> list[torch.Tensor]:
    """The weights after the run, by all shares one after the other in this process."""
    learners, generators, count = list[Any](), [], settings.processes
    for rank in range(count):
        prepare_torch(1, settings.seed)
        learners.append(build_env_and_learner(parts_of(settings, rank), None)[2])
        if rank:
            own = np.random.SeedSequence([settings.seed, rank]).generate_state(1, np.uint64)
            torch.manual_seed(int(own[0]))
        generators.append(torch.get_rng_state())
    hyper, network = learners[0].settings, learners[0].network
    adam = torch.optim.Adam(network.parameters(), eps=hyper.adam_epsilon, fused=True)
    while count * learners[0].frames < settings.frames:
        progress = count * learners[0].frames / settings.frames
        adam.param_groups[0]["lr"] = learners[0].annealed(hyper.learning_rate, progress)
        entropy_coef = learners[0].annealed(hyper.entropy_coef, progress)
        shares = []
        for rank, learner in enumerate(learners):
            torch.set_rng_state(generators[rank])
            frames = learner.collect()
            orders = [torch.randperm(len(frames["advantage"])) for _ in range(hyper.epochs)]
            size = hyper.minibatch_size
            chosen = [c for order in orders for c in torch.split(order, size) if len(c) == size]
            shares.append([select(frames, c) for c in chosen])
            generators[rank] = torch.get_rng_state()
        for minibatches in zip(*shares, strict=True):
            gradients = []
            for learner, minibatch in zip(learners, minibatches, strict=True):
                leaves = list(learner.network.parameters())
                coefficients = LossCoefficients(hyper.clip, hyper.value_coef, entropy_coef)
                learner.engine.set_gradients(minibatch, coefficients)
                gradients.append([weight.grad.clone() for weight in leaves])
            for weight, *all_of_it in zip(network.parameters(), *gradients, strict=True):
                weight.grad = torch.stack(all_of_it).sum(dim=0) * (1.0 / count)
            clip_gradients(list(network.parameters()), hyper.max_grad_norm)
            adam.step()
            for learner in learners[1:]:
                learner.network.load_state_dict(network.state_dict())
    return [weight.detach() for weight in network.parameters()]


@pytest.mark.parametrize(
    "processes, activation",
    [(2, "relu"), (2, "tanh"), (3, "relu")],  # with gradients written out, and not
)
def test_several_processes_learn_the_same_as_one_from_all_shares(
    processes: int, activation: str, tmp_path: Path
) -> None:
    more = {"minibatch_size": 66, "processes": processes, "epochs": 2}  # 24 games
    settings = tiny("ppo", **{**TWO, **more}, activation=activation)
    run = start(RUN, settings, tmp_path / "run")
    fresh = weights_of(run)
    run.train()
    learned = weights_of(run)
    assert run.trainee.frames >= settings.frames == 900
    assert not any(torch.equal(a, b) for a, b in zip(fresh, learned, strict=True))
    for one, other in zip(learned, plainly(settings), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_all_processes_have_the_same_weights_after_every_iteration(tmp_path: Path) -> None:
    more = {"minibatch_size": 66, "processes": 3, "kl_target": 0.001, "kl_coef": 0.2}
    run = start(RUN, tiny("ppo", **{**TWO, **more}), tmp_path / "run")
    trainee, digests, weight = run.trainee, [], 0.0

    def compare(run: Run[Any], row: dict[str, float]) -> None:
        for number in range(2):
            trainee.replicas.send(None, number)
        others = [trainee.replicas.receive(number)[1] for number in range(2)]
        digests.append({weights_digest(trainee.learner), *others})

    run.train(compare)
    assert len(digests) > 4 and all(len(equal) == 1 for equal in digests)
    assert digests[0] != digests[-1]
    weight = trainee.learner.kl_coef
    assert weight != 0.2 and weight > 0  # adapted, by the divergence of both


def test_weights_that_differ_are_noticed(tmp_path: Path) -> None:
    run = start(RUN, tiny("ppo", **TWO), tmp_path / "run")
    with torch.no_grad():
        next(run.trainee.learner.network.parameters())[0] += 1e-6
    with pytest.raises(RuntimeError, match="different weights"):
        run.train()


@pytest.mark.parametrize("count", [2, 3])
def test_the_games_of_all_are_those_of_one_process(count: int) -> None:
    def games(processes: int, rank: int) -> dict[str, torch.Tensor]:
        more = {"minibatch_size": 66, "processes": processes}
        settings = tiny("ppo", **RUNNER, **more, seed=7)
        return simulator_tensors(build_env_and_learner(parts_of(settings, rank), None)[0].simulator)

    whole, shares = games(1, 0), [games(count, rank) for rank in range(count)]
    for name, state in whole.items():
        joined = torch.cat([share[name] for share in shares])
        torch.testing.assert_close(joined, state, rtol=0, atol=0, equal_nan=True)


def test_episodes_of_both_are_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = start(RUN, tiny("ppo", **TWO), tmp_path / "run")
    trainee, lengths = run.trainee, []
    monkeypatch.setattr(SingleAgent, "forget_episodes", lambda self: None)
    monkeypatch.setattr(trainee, "evaluate", lambda: {"mean_steps": 1.0})
    run.train(lambda run, row: lengths.append(sum(map(len, trainee.env.finished_lengths))))
    alone = start(RUN, tiny("ppo", **RUNNER), tmp_path / "alone")
    monkeypatch.setattr(alone.trainee, "evaluate", lambda: {"mean_steps": 1.0})
    alone.train()
    one = sum(map(len, alone.trainee.env.finished_lengths))
    assert 0.7 * one < lengths[-1] < 1.4 * one


# -- resumption ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "flat",
    [
        {"kl_target": 0.01, "frame_stack": 2},
        {**CHASER, "curriculum": "opponent-epsilon"},
        {"task": "reacher", "joints": 2, "curriculum": "target-distance"},
        {"processes": 3, "minibatch_size": 66, "curriculum": "uniform", "schedule_unit": None},
    ],
    ids=lambda flat: " ".join(map(str, flat.values())),
)
def test_several_processes_resume(flat: dict[str, Any], tmp_path: Path) -> None:
    given = {name: value for name, value in {**TWO, **flat}.items() if value is not None}
    if flat.get("task") == "reacher":
        given = {**flat, "processes": 2, "max_steps": 12}
    check_resumption(RUN, tiny("ppo", **given), tmp_path)
    state = load_checkpoint(tmp_path / "whole")["trainee"]
    others = state["partners"]
    assert len(others) == given["processes"] - 1
    for other in others:
        assert set(other) == {"teacher", "simulator", "memories", "finished", "torch_rng"}
    if flat.get("curriculum") == "uniform":  # its own stages
        playing = [each["teacher"]["arrays"]["playing"] for each in (state, *others)]
        assert not any(torch.equal(a, b) for a, b in combinations(playing, 2))


def test_a_checkpoint_of_two_processes_of_an_earlier_version_resumes(tmp_path: Path) -> None:
    start(RUN, tiny("ppo", **TWO), tmp_path / "run").train()
    saved = load_checkpoint(tmp_path / "run")
    [saved["trainee"]["partner"]] = saved["trainee"].pop("partners")
    save_checkpoint(tmp_path / "run", saved)
    again = open_run(tmp_path / "run")
    assert again.progress == 1.0
    again.trainee.close()


def test_a_checkpoint_of_another_number_of_processes_is_refused(tmp_path: Path) -> None:
    start(RUN, tiny("ppo", **TWO), tmp_path / "run").train()
    saved = load_checkpoint(tmp_path / "run")
    del saved["trainee"]["partners"]
    save_checkpoint(tmp_path / "run", saved)
    with pytest.raises(ValueError, match=r"does not match .*from a run with processes=1"):
        open_run(tmp_path / "run")
    assert not multiprocessing.active_children()


def test_runs_of_one_process_have_no_second_process_and_another_name(tmp_path: Path) -> None:
    run = start(RUN, tiny("ppo", **RUNNER), tmp_path / "run")
    run.train()
    assert open_run(tmp_path / "run").trainee.replicas is None
    assert "partners" not in load_checkpoint(tmp_path / "run")["trainee"]
    digests = {n: fingerprint(RUN, tiny("ppo", **RUNNER, processes=n), 9, {}) for n in (1, 2)}
    assert digests[1] != digests[2]


# -- exits -----------------------------------------------------------------------------------------


def train_and(run: Run, act: Callable[[Run], object]) -> None:
    """Train, and call `act` after the first checkpoint."""

    def report(run: Run, row: dict[str, float]) -> None:
        if not row and run.evaluations == 1:
            act(run)

    run.train(report)


def test_a_killed_process_ends_the_run_which_resumes_from_its_checkpoint(tmp_path: Path) -> None:
    more = {"minibatch_size": 66, "processes": 3}
    run = start(RUN, tiny("ppo", **{**TWO, **more}), tmp_path / "run")
    process = run.trainee.replicas.workers[-1]
    with pytest.raises(ProcessEnded, match=r"process 3 .*killed by signal 9 .*--resume"):
        train_and(run, lambda run: os.kill(process.pid, signal.SIGKILL))
    assert process.exitcode == -signal.SIGKILL and not multiprocessing.active_children()
    again = open_run(tmp_path / "run")
    assert 0 < again.trainee.frames < 900
    again.train()
    assert again.progress == 1.0


def test_a_second_process_killed_before_the_first_checkpoint_leaves_none(tmp_path: Path) -> None:
    run = start(RUN, tiny("ppo", **TWO), tmp_path / "run")
    os.kill(run.trainee.replicas.workers[0].pid, signal.SIGKILL)
    with pytest.raises(ProcessEnded, match=r"killed by signal 9 .*the run has no checkpoint yet"):
        run.train()
    assert not (tmp_path / "run" / CHECKPOINT).exists()


@pytest.mark.parametrize("kind, seen", [(ValueError, ValueError), (KeyError, ProcessEnded)])
def test_an_error_of_the_second_process_is_raised_by_the_run(
    kind: type[Exception], seen: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, iterate = os.getpid(), PPO.iterate

    def fail(self: PPO, progress: float) -> dict[str, float]:
        if os.getpid() != mine and progress > 0.5:
            raise kind("beyond the half")
        return iterate(self, progress)

    monkeypatch.setattr(PPO, "iterate", fail)
    run = start(RUN, tiny("ppo", **TWO), tmp_path / "run")
    with pytest.raises(seen, match="beyond the half"):
        run.train()
    assert not multiprocessing.active_children() and (tmp_path / "run" / CHECKPOINT).exists()


def test_the_second_process_ends_with_the_run_for_any_reason(tmp_path: Path) -> None:
    run = start(RUN, tiny("ppo", **TWO), tmp_path / "run")
    process = run.trainee.replicas.workers[0]
    for number in (signal.SIGINT, signal.SIGTERM):  # the process of the run says what follows
        os.kill(process.pid, number)
    with pytest.raises(KilledError):
        train_and(run, kill)
    assert process.exitcode == 0 and not multiprocessing.active_children()


def test_the_second_process_ends_when_the_run_is_garbage_collected(tmp_path: Path) -> None:
    run = start(RUN, tiny("ppo", **TWO), tmp_path / "run")
    assert len(multiprocessing.active_children()) == 1
    del run
    gc.collect()
    assert not multiprocessing.active_children()


def test_divergence_is_reported_as_with_one_process(tmp_path: Path) -> None:
    run = start(RUN, tiny("ppo", **TWO, learning_rate=1e30, max_grad_norm=1e30), tmp_path / "run")
    with pytest.raises(Diverged, match="learning_rate"):
        run.train()
    assert not multiprocessing.active_children()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/comm").exists(), reason="processes are found by /proc")
@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGKILL, marks=pytest.mark.slow), signal.SIGINT]
)
def test_signals_end_both_processes_of_the_command(number: int, tmp_path: Path) -> None:
    """Started anew for the one, for the other forked where libraries have no threads; SIGINT goes
    to both, as Ctrl-C does."""
    folder, before, killed = tmp_path / "run", memory_files(), number == signal.SIGKILL
    command = "train --task maze --maze 3x3 --num-goals 2 --processes 2 --frames 3000000 --out"
    process = subprocess.Popen(
        [sys.executable, "-m", "train.commands.main", *command.split(), str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "2" if killed else "1"},
    )
    wait_until((folder / CHECKPOINT).exists, process)
    found = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (os.kill if killed else os.killpg)(process.pid, number)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == (-number if killed else 130), errors
    assert killed or b"interrupted; saved at " in errors
    assert b"Traceback" not in errors
    wait_until(lambda: not any(map(is_running, found)))
    assert found and memory_files() <= before
    assert 0 < open_run(folder).progress < 1  # it can go on from there


def is_running(process: str) -> bool:
    """Whether a process is running."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def memory_files() -> set[str]:
    """The named shared memory."""
    return {
        path.name for path in Path("/dev/shm").glob("*") if path.name.startswith(("py", "torch"))
    }


# -- validation ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "flat, words",
    [
        ({"processes": 3}, "minibatch_size=64 with processes=3; use a multiple of 3 of at least 6"),
        ({"processes": 0}, "processes=0; give at least 1"),
        ({"algorithm": "a2c"}, "algorithm='a2c' with processes=2; use ppo"),
        ({"device": "cuda"}, "device='cuda' with processes=2; use cpu"),
        ({"clock": "processor", "seconds": 9.0, "frames": None}, "with processes=2; use wall"),
        ({"threads": 2}, "threads=2 with processes=2; leave it out"),
        ({"recurrent": "gru"}, "recurrent='gru' with processes=2; leave it out"),
        ({"num_games": 25}, "num_games=25 with processes=2; .* multiple of 2"),
        ({"minibatch_size": 2}, "minibatch_size=2 with processes=2; .* at least 4"),
        ({"curriculum": "success-gated", "solved_within": 0.0}, "curriculum='success-gated' with"),
        ({"curriculum": "level-replay"}, "others depend on the episodes"),
        (
            {"curriculum": "num-goals", "schedule_unit": "episodes", "schedule_length": 9},
            "episodes",
        ),
    ],
    ids=lambda given: str(given)[:40],
)
def test_settings_that_two_processes_do_not_support_are_refused(
    flat: dict[str, Any], words: str
) -> None:
    small = {"frames": 900, "num_games": 24, "minibatch_size": 64, "rollout_steps": 3}
    given = {**small, **TWO, **flat}
    given = {name: value for name, value in given.items() if value is not None}
    if given.get("algorithm") == "a2c":
        del given["minibatch_size"]
    with pytest.raises(ValueError, match=words):
        settings_of(**given)


def test_self_play_has_no_second_process() -> None:
    with pytest.raises(ValueError, match="processes"):
        self_play_settings_of(processes=2, frames=900)
