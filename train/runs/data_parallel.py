"""Data parallel training in two processes, each with half of the games.

Both processes start with the same weights and average their gradients before each step of Adam, so
that the weights stay equal. Gradients are exchanged in shared memory without a name, which is freed
when both processes have ended. All other messages go through two connected sockets, so that a
waiting process notices if the other one ends. The second process only reacts to messages.

`torch.distributed` is slower: an all_reduce by gloo of PPO's 27,013 weights took 1.2 to 1.4 ms of
each processor, this exchange takes 0.23 to 0.31 ms. A gradient step with its part of the rollout
takes 10 ms.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import signal
import traceback
import warnings
from multiprocessing import get_context
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.plugins import environment
from train.algorithms.learner import averaged_buffers
from train.runs.folder import CHECKPOINT
from train.runs.parts import parts_of
from train.runs.threads import can_fork, prepare_torch
from train.runs.training_state import build_env_and_learner, training_state
from train.settings.checks import check
from train.settings.run import TrainSettings

END_TIMEOUT = 1.0
"""Seconds that a process has to end by itself after the connection is closed."""


class ProcessEnded(ChildProcessError):
    """The other process has ended or failed."""


class Replica:
    """One of the two processes, with its connection to the other one.

    Args:
        connection: to the other process.
        shared: four times as many float32 as there are weights.
        rank: 0 in the process of the run, 1 in the second one.
    """

    def __init__(self, connection: Any, shared: Any, rank: int) -> None:
        self.connection, self.rank = connection, rank
        # Two slots each, used alternately, so that the faster process does not overwrite a slot
        # that the other one still reads.
        self.slots = torch.frombuffer(shared, dtype=torch.float32).view(2, 2, -1)
        self.turn = 0

    def send(self, content: Any) -> None:
        """Send a message; if the other process has ended, `receive` reports it."""
        with contextlib.suppress(OSError):
            # pickled here, as multiprocessing would put tensors into named shared memory
            self.connection.send_bytes(pickle.dumps(content))

    def receive(self) -> Any:
        """The next message; ProcessEnded if the other process ended, its exception if it failed."""
        try:
            content = pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError):
            raise ProcessEnded(self.end_reason()) from None
        if isinstance(content, Exception):
            raise content
        return content

    def average(self, tensors: list[torch.Tensor]) -> None:
        """Replace every tensor by its mean over both processes, which must have equal shapes."""
        sizes = [tensor.numel() for tensor in tensors]
        slots = self.slots[self.turn, :, : sum(sizes)]
        self.turn = 1 - self.turn
        torch.cat([tensor.reshape(-1) for tensor in tensors], out=slots[self.rank])
        self.send(None)
        self.receive()
        mean: Any = slots.sum(dim=0).mul_(0.5)
        for tensor, part in zip(tensors, mean.split(sizes), strict=True):
            tensor.copy_(part.view_as(tensor))

    def end_reason(self) -> str:
        """The reason why the other process has ended."""
        return "the process of the run has ended"


class SecondProcess(Replica):
    """The second process, as seen from the first one.

    It is forked if this process has a single thread, which takes no time. Otherwise it is spawned,
    which takes seconds, as it imports torch.

    Args:
        settings: of the run.
        learner: of this process; its gradients are averaged from now on.
        folder: of the run.
        state: of the trainee in a checkpoint; None for a new run.

    Raises:
        ProcessEnded: it could not be started.
        ValueError: the checkpoint is from a run with one process.
    """

    def __init__(
        self,
        settings: TrainSettings[Any],
        learner: Any,
        folder: Path,
        state: dict[str, Any] | None = None,
    ) -> None:
        context: Any = get_context("fork" if can_fork() else "spawn")
        kept = [*learner.network.parameters(), *averaged_buffers(learner.network)]
        weights = sum(each.numel() for each in kept)
        shared = context.RawArray("f", 4 * weights)
        ours, theirs = context.Pipe()
        super().__init__(ours, shared, 0)
        self.folder, self.learner = folder, learner
        given = (ours, theirs, shared, settings, environment())
        self.process = context.Process(target=serve, args=given, name="second process", daemon=True)
        self.process.start()
        theirs.close()
        self.close = Finalize(self, end, (ours, self.process), exitpriority=0)
        self.send(state)
        try:
            self.check_equal_weights(self.receive())
        except Exception:
            self.close()
            raise
        learner.average = self.average

    def iterate(
        self, progress: float, seconds: float
    ) -> tuple[dict[str, float], list[NDArray[Any]], list[NDArray[Any]]]:
        """An iteration of both processes: the values for the log, and the returns and lengths of
        the episodes that ended in the second one."""
        self.send((progress, seconds))
        figures = self.learner.iterate(progress)
        others, returns, lengths = self.receive()
        both = {name: 0.5 * (value + others[name]) for name, value in figures.items()}
        return both, returns, lengths

    def state(self) -> dict[str, Any]:
        """The state of the second process for a checkpoint, without the weights, which are equal.

        Raises:
            RuntimeError: the weights differ.
        """
        self.send(None)
        state, digest = self.receive()
        self.check_equal_weights(digest)
        found: dict[str, Any] = state
        return found

    def check_equal_weights(self, digest: bytes) -> None:
        """RuntimeError if the weights of the second process differ."""
        if digest != digest_of(self.learner):
            raise RuntimeError("the two processes of this run have different weights")

    def end_reason(self) -> str:
        """The reason, and what the user can do."""
        text = "the second process of this run has ended"
        self.process.join(END_TIMEOUT)
        code = self.process.exitcode
        if code == 1:  # multiprocessing has printed the error
            return f"{text}: see above. A script that starts it needs `if __name__ == '__main__':`"
        if code is not None and code < 0:
            text += f", killed by signal {-code} ({signal.Signals(-code).name})"
        if not (self.folder / CHECKPOINT).exists():
            return f"{text}; the run has no checkpoint yet: start it again"
        return f"{text}; the last checkpoint is kept: resume the run by --resume"


def end(connection: Any, process: Any) -> None:
    """End the second process; also called at garbage collection."""
    connection.close()
    process.join(END_TIMEOUT)
    process.kill()
    process.join()


def serve(
    ours: Any, theirs: Any, shared: Any, settings: TrainSettings[Any], variables: dict[str, str]
) -> None:
    """The main function of the second process, until that of the run ends."""
    # A terminal sends signals to all its processes; the process of the run handles them.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    ours.close()
    os.environ.update(variables)
    warnings.simplefilter("ignore")  # the first process prints them
    replica = Replica(theirs, shared, 1)
    try:
        serve_messages(replica, settings)
    except ProcessEnded:
        return
    except ValueError as error:
        replica.send(ValueError(str(error)))
    except Exception:
        replica.send(
            ProcessEnded(f"the second process of this run failed:\n{traceback.format_exc()}")
        )


def serve_messages(replica: Replica, settings: TrainSettings[Any]) -> None:
    """Build the learner for the other half of the games, and handle messages."""
    prepare_torch(1, settings.seed)
    parts, state = parts_of(settings, replica.rank), replica.receive()
    if state is None:
        env, teacher, learner = build_env_and_learner(parts, None)
        apart = np.random.SeedSequence([settings.seed, replica.rank])
        torch.manual_seed(int(apart.generate_state(1, np.uint64)[0]))  # for the actions
    else:
        check("partner" in state, "the checkpoint is from a run with processes=1")
        env, teacher, learner = build_env_and_learner(parts, {**state, **state["partner"]})
        torch.set_rng_state(state["partner"]["torch_rng"])
    learner.average = replica.average
    replica.send(digest_of(learner))
    while True:
        message = replica.receive()
        if message is None:
            if teacher is not None:
                teacher.forget_episodes()  # which only the first process logs
            own = {**training_state(env, teacher, learner), "torch_rng": torch.get_rng_state()}
            del own["learner"]
            replica.send((own, digest_of(learner)))
            continue
        progress, seconds = message
        if teacher is not None:
            teacher.update(progress, learner.frames * settings.processes, seconds)
        replica.send((learner.iterate(progress), env.finished_returns, env.finished_lengths))
        env.finished_returns.clear()
        env.finished_lengths.clear()


def digest_of(learner: Any) -> bytes:
    """A digest of the bits of the weights."""
    digest = hashlib.sha256()
    for weight in learner.network.state_dict().values():
        digest.update(weight.numpy().tobytes())
    return digest.digest()
