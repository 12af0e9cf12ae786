"""Data parallel training in several processes, each with an equal share of the games.

All processes start with the same weights and average their gradients before each step of Adam, so
that the weights stay equal. Gradients are exchanged in shared memory without a name, which is freed
when all processes have ended. All other messages go through sockets that connect the process of the
run with each of the others, so that a waiting process notices if one ends. The others only react to
messages.

`torch.distributed` is slower: in two processes an all_reduce by gloo of PPO's 27,013 weights took
1.2 to 1.4 ms of each processor, this exchange takes 0.23 to 0.31 ms. A gradient step with its part
of the rollout takes 10 ms.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import pickle
import signal
import traceback
import warnings
from itertools import chain
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.plugins import environment
from pursuit.validation import check
from train.algorithms.learner import averaged_buffers
from train.algorithms.ppo import PPO
from train.files import Plain
from train.runs.folder import CHECKPOINT
from train.runs.parts import parts_of
from train.runs.threads import can_fork, prepare_torch
from train.runs.training_state import build_env_and_learner, training_state
from train.settings.run import AgentSettings
from train.tensors import own_defaults

END_TIMEOUT = 1.0
"""Seconds that a process has to end by itself after the connection is closed."""

SharedNumbers = ctypes.Array[ctypes.c_float]


class ProcessEnded(ChildProcessError):
    """Another process of the run has ended or failed."""


class Replica:
    """One of the processes, with its connections.

    Args:
        connections: of the process of the run to each other process; of these to that one.
        shared: for each process twice as many float32 as there are weights.
        rank: 0 in the process of the run, 1, 2, ... in the others.
        processes: their number.
    """

    def __init__(
        self, connections: list[Connection], shared: SharedNumbers, rank: int, processes: int
    ) -> None:
        self.connections, self.rank, self.processes = connections, rank, processes
        # Two slots each, used alternately, so that a fast process does not overwrite a slot that
        # another one still reads.
        self.slots = torch.frombuffer(shared, dtype=torch.float32).view(2, processes, -1)
        self.turn = 0

    def send(self, content: object, to: int = 0) -> None:
        """Send a message by a connection; if that process has ended, `receive` reports it."""
        with contextlib.suppress(OSError):
            # pickled here, as multiprocessing would put tensors into named shared memory
            self.connections[to].send_bytes(pickle.dumps(content))

    def receive(self, source: int = 0) -> Any:
        """The next message of a connection; ProcessEnded if the process there has ended, its
        exception if it failed."""
        try:
            content = pickle.loads(self.connections[source].recv_bytes())
        except (EOFError, OSError):
            raise ProcessEnded(self.end_reason(source)) from None
        if isinstance(content, Exception):
            raise content
        return content

    def wait_for_all(self) -> None:
        """Wait until all processes have called this.

        The process of the run tells the last one first: two processes send at the same time.
        """
        *others, last = range(len(self.connections))
        for number in others:
            self.receive(number)
        self.send(None, last)
        self.receive(last)
        for number in others:
            self.send(None, number)

    def average(self, tensors: list[torch.Tensor]) -> None:
        """Replace every tensor by its mean over the processes, which must have equal shapes."""
        sizes = [tensor.numel() for tensor in tensors]
        slots = self.slots[self.turn, :, : sum(sizes)]
        self.turn = 1 - self.turn
        torch.cat([tensor.reshape(-1) for tensor in tensors], out=slots[self.rank])
        self.wait_for_all()
        mean = slots.sum(dim=0).mul_(1.0 / self.processes)
        for tensor, part in zip(tensors, mean.split(sizes), strict=True):  # type: ignore[no-untyped-call]
            tensor.copy_(part.view_as(tensor))

    def end_reason(self, source: int) -> str:
        """The reason why the process at a connection has ended."""
        return "the process of the run has ended"


class OtherProcesses(Replica):
    """The other processes, as seen from that of the run.

    They are forked if this process has a single thread, which takes no time. Otherwise they are
    spawned, which takes seconds, as they import torch.

    Args:
        settings: of the run.
        learner: of this process; its gradients are averaged from now on.
        folder: of the run.
        state: of the trainee in a checkpoint; None for a new run.

    Raises:
        ProcessEnded: one could not be started.
        ValueError: the checkpoint is from a run with another number of processes.
    """

    def __init__(
        self, settings: AgentSettings, learner: PPO, folder: Path, state: Plain | None = None
    ) -> None:
        count = settings.processes
        context: Any = get_context("fork" if can_fork() else "spawn")
        kept = [*learner.network.parameters(), *averaged_buffers(learner.network)]
        weights = sum(each.numel() for each in kept)
        shared = context.RawArray(ctypes.c_float, 2 * count * weights)
        super().__init__([], shared, 0, count)
        self.folder, self.learner = folder, learner
        self.workers: list[BaseProcess] = []
        self.close = Finalize(self, end, (self.connections, self.workers), exitpriority=0)
        try:
            for rank in range(1, count):
                ours, theirs = context.Pipe()
                self.connections.append(ours)
                # A forked process inherits our ends of all connections so far.
                given = (self.connections, theirs, shared, rank, settings, environment())
                name = f"process {rank + 1}"
                worker = context.Process(target=serve, args=given, name=name, daemon=True)
                worker.start()
                self.workers.append(worker)
                theirs.close()
                self.send(state, rank - 1)
            for number in range(count - 1):
                self.check_equal_weights(self.receive(number))
        except Exception:
            self.close()
            raise
        learner.average = self.average

    def iterate(
        self, progress: float, seconds: float
    ) -> tuple[dict[str, float], list[NDArray[np.float64]], list[NDArray[np.int32]]]:
        """An iteration of all processes: the values for the log, and the returns and lengths of the
        episodes that ended in the others."""
        for number in range(len(self.connections)):
            self.send((progress, seconds), number)
        own = self.learner.iterate(progress)
        others, returns, lengths = zip(*self._answers(), strict=True)
        figures = [own, *others]
        mean = {name: sum(each[name] for each in figures) / self.processes for name in own}
        return mean, [*chain(*returns)], [*chain(*lengths)]

    def _answers(self) -> list[Any]:
        """A message of each other process."""
        return [self.receive(number) for number in range(len(self.connections))]

    def states(self) -> list[Plain]:
        """The states of the others for a checkpoint, without the weights, which are equal.

        Raises:
            RuntimeError: the weights differ.
        """
        for number in range(len(self.connections)):
            self.send(None, number)
        answers = self._answers()
        for _, digest in answers:
            self.check_equal_weights(digest)
        return [state for state, _ in answers]

    def check_equal_weights(self, digest: bytes) -> None:
        """RuntimeError if the weights of another process differ."""
        if digest != weights_digest(self.learner):
            raise RuntimeError("the processes of this run have different weights")

    def end_reason(self, source: int) -> str:
        """The reason, and what the user can do."""
        worker = self.workers[source]
        text = f"process {source + 2} of this run has ended"
        worker.join(END_TIMEOUT)
        code = worker.exitcode
        if code == 1:  # multiprocessing has printed the error
            return f"{text}: see above. A script that starts it needs `if __name__ == '__main__':`"
        if code is not None and code < 0:
            text += f", killed by signal {-code} ({signal.Signals(-code).name})"
        if not (self.folder / CHECKPOINT).exists():
            return f"{text}; the run has no checkpoint yet: start it again"
        return f"{text}; the last checkpoint is kept: resume the run by --resume"


def end(connections: list[Connection], workers: list[BaseProcess]) -> None:
    """End the other processes; also called at garbage collection."""
    for connection in connections:
        connection.close()
    for worker in workers:
        worker.join(END_TIMEOUT)
        worker.kill()
        worker.join()


def serve(
    inherited: list[Connection],
    connection: Connection,
    shared: SharedNumbers,
    rank: int,
    settings: AgentSettings,
    variables: dict[str, str],
) -> None:
    """The main function of another process, until that of the run ends."""
    # A terminal sends signals to all its processes; the process of the run handles them.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    for other in inherited:
        other.close()
    os.environ.update(variables)
    warnings.simplefilter("ignore")  # the first process prints them
    replica = Replica([connection], shared, rank, settings.processes)
    try:
        serve_messages(replica, settings)
    except ProcessEnded:
        return
    except ValueError as error:
        replica.send(ValueError(str(error)))
    except Exception:
        text = f"process {rank + 1} of this run failed:\n{traceback.format_exc()}"
        replica.send(ProcessEnded(text))


@own_defaults()
def serve_messages(replica: Replica, settings: AgentSettings) -> None:
    """Build the learner for a share of the games, and handle messages."""
    prepare_torch(1, settings.seed)
    parts, state = parts_of(settings, replica.rank), replica.receive()
    if state is None:
        env, teacher, learner = build_env_and_learner(parts, None)
        apart = np.random.SeedSequence([settings.seed, replica.rank])
        torch.manual_seed(int(apart.generate_state(1, np.uint64)[0]))  # for the actions
    else:
        # "partner" stands in checkpoints of two processes that earlier versions wrote.
        others = state.get("partners", [state["partner"]] if "partner" in state else [])
        count = 1 + len(others)
        check(count == settings.processes, f"the checkpoint is from a run with processes={count}")
        own = others[replica.rank - 1]
        env, teacher, learner = build_env_and_learner(parts, {**state, **own})
        torch.set_rng_state(own["torch_rng"])
    assert isinstance(learner, PPO)
    learner.average = replica.average
    replica.send(weights_digest(learner))
    while True:
        message = replica.receive()
        if message is None:
            if teacher is not None:
                teacher.forget_episodes()  # which only the first process logs
            own = {**training_state(env, teacher, learner), "torch_rng": torch.get_rng_state()}
            del own["learner"]
            replica.send((own, weights_digest(learner)))
            continue
        progress, seconds = message
        if teacher is not None:
            teacher.update(progress, learner.frames * settings.processes, seconds)
        replica.send((learner.iterate(progress), env.finished_returns, env.finished_lengths))
        env.finished_returns.clear()
        env.finished_lengths.clear()


def weights_digest(learner: PPO) -> bytes:
    """A digest of the bits of the weights."""
    digest = hashlib.sha256()
    for weight in learner.network.state_dict().values():
        digest.update(weight.numpy().tobytes())
    return digest.digest()
