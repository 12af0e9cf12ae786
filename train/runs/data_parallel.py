"""A second process that learns the same policy, from its own half of the games.

Both begin with the same weights, play half of the games each, and take their gradient steps
together: each puts the gradient of its own minibatch into shared memory, waits for that of the
other, and takes the mean of the two, which is the same in both to the last bit. So are the steps of
Adam that follow, and the weights, which are never sent. The process of the run decides: it asks its
partner to iterate, or for what a checkpoint needs of it; a partner that is asked nothing sleeps.

What they say to each other, that a gradient is there included, goes through a pair of connected
sockets. So whoever waits hears at once when the other has ended, however that happened, and the
shared memory, which has no name, goes with them.

It is no `torch.distributed`: on the 27,013 weights of PPO's default network an all_reduce by gloo
took 1.2 to 1.4 ms of each processor and this exchange 0.23 to 0.31 (2,000 each, in turns, three
times; 4 times as long by the clock as well, on two busy cores). A gradient step with its share of
playing takes 10 ms, so a run would be more than a tenth slower.
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
from train.algorithms.ppo import network_of
from train.runs.folder import CHECKPOINT
from train.runs.in_play import begin, state_in_play
from train.runs.parts import Parts, parts_of
from train.runs.threads import can_fork, prepare_torch
from train.settings.checks import check
from train.settings.run import TrainSettings

IN_PLAY = ("teacher", "simulator", "memories")
"""What of `state_in_play` each has its own of; and the state of torch's generator."""
AT_ONCE = 1.0
"""Seconds that a process gets to end by itself when it has heard that it is over."""


class Gone(ChildProcessError):
    """The other process has ended, or failed."""


class Pair:
    """One of two processes that learn together, as it meets the other.

    Args:
        connection: to the other, both ways.
        shared: four times as many float32 as there are weights.
        rank: 0 in the process of the run, 1 in its partner.
        process: the partner, where this is not it.
        folder: of the run, there.
    """

    def __init__(
        self,
        connection: Any,
        shared: Any,
        rank: int,
        process: Any = None,
        folder: Path | None = None,
    ) -> None:
        self.connection, self.rank, self.process = connection, rank, process
        self.folder = folder
        # Two slots each, in turns: whoever is ahead must not write where the other may still read.
        # Two turns later it may: the other has spoken since, and so has read.
        self.slots = torch.frombuffer(shared, dtype=torch.float32).view(2, 2, -1)
        self.turn = 0

    def say(self, content: Any) -> None:
        """Tell the other; Gone where it has ended."""
        try:  # torch has multiprocessing's own pickling put tensors into shared memory with names
            self.connection.send_bytes(pickle.dumps(content))
        except OSError:
            self.hear()  # its last word
            raise Gone(self._how_it_ended()) from None

    def hear(self) -> Any:
        """What the other says next; Gone where it has failed or ended."""
        try:
            content = pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError):
            raise Gone(self._how_it_ended()) from None
        if isinstance(content, Exception):
            raise content
        return content

    def average(self, tensors: list[torch.Tensor]) -> None:
        """Make every tensor its mean over both processes; as many of the same shapes in both."""
        sizes = [tensor.numel() for tensor in tensors]
        slots = self.slots[self.turn, :, : sum(sizes)]
        self.turn = 1 - self.turn
        torch.cat([tensor.reshape(-1) for tensor in tensors], out=slots[self.rank])
        self.say(None)
        self.hear()
        mean: Any = slots.sum(dim=0).mul_(0.5)
        for tensor, part in zip(tensors, mean.split(sizes), strict=True):
            tensor.copy_(part.view_as(tensor))

    def _how_it_ended(self) -> str:
        told = "the second process of this run has ended"
        if self.process is None or self.folder is None:
            return told
        self.process.join(AT_ONCE)
        code = self.process.exitcode
        if code == 1:  # multiprocessing has printed why
            return f"{told}: see above. A script that starts it needs `if __name__ == '__main__':`"
        if code is not None and code < 0:
            told += f", killed by signal {-code} ({signal.Signals(-code).name})"
        if not (self.folder / CHECKPOINT).exists():
            return f"{told}; it has no checkpoint yet: begin it anew"
        return f"{told}; its last checkpoint is kept: go on from there by --resume"


class Partner:
    """The second process, as that of the run sees it.

    It is forked where this process has one thread, which takes no time, and started anew elsewhere,
    where it imports torch first, which takes seconds.

    Args:
        settings: of the run.
        parts: made of them.
        folder: of the run.
        state: of the trainee in a checkpoint; None begins.

    Raises:
        Gone: it could not be started.
    """

    def __init__(
        self,
        settings: TrainSettings[Any],
        parts: Parts,
        folder: Path,
        state: dict[str, Any] | None = None,
    ) -> None:
        context: Any = get_context("fork" if can_fork() else "spawn")
        network = network_of(settings.hyper, parts.seat, parts.build)
        shared = context.RawArray("f", 4 * sum(weight.numel() for weight in network.parameters()))
        ours, theirs = context.Pipe()
        given = (ours, theirs, shared, settings, environment())
        self.process = context.Process(target=serve, args=given, name="partner", daemon=True)
        self.process.start()
        theirs.close()
        self.pair = Pair(ours, shared, 0, self.process, folder)
        self._end = Finalize(self, end, (ours, self.process), exitpriority=0)
        self.pair.say(state)

    def begun(self, learner: Any) -> None:
        """Wait until it has begun, and learn with it from now on."""
        _check_same(self.pair.hear(), learner)
        learner.average = self.pair.average

    def iterate(self, progress: float, seconds: float) -> None:
        """Have it take part in the next iteration, and hear of that with `iterated`."""
        self.pair.say((progress, seconds))

    def iterated(self) -> tuple[dict[str, float], list[NDArray[Any]], list[NDArray[Any]]]:
        """Its figures, and the returns and lengths of the episodes that ended in its games."""
        found: tuple[dict[str, float], list[NDArray[Any]], list[NDArray[Any]]] = self.pair.hear()
        return found

    def state(self, learner: Any) -> dict[str, Any]:
        """What a checkpoint needs of it; its weights are those of `learner`.

        Raises:
            RuntimeError: they are not.
        """
        self.pair.say(None)
        state, digest = self.pair.hear()
        _check_same(digest, learner)
        found: dict[str, Any] = state
        return found

    def close(self) -> None:
        """End it; so does Python, when nobody has it any more."""
        self._end()


def end(connection: Any, process: Any) -> None:
    """End the partner, which has nothing to save."""
    connection.close()
    process.join(AT_ONCE)
    process.kill()
    process.join()


def serve(
    ours: Any, theirs: Any, shared: Any, settings: TrainSettings[Any], variables: dict[str, str]
) -> None:
    """The partner: all that it does until the process of the run is gone."""
    # They go to all processes of a terminal or a job; the process of the run says what follows.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    ours.close()
    os.environ.update(variables)
    warnings.simplefilter("ignore")  # the other has been warned
    pair = Pair(theirs, shared, 1)
    with contextlib.suppress(Gone):
        try:
            learn_beside(pair, settings)
        except Gone:
            raise
        except ValueError as error:
            pair.say(ValueError(str(error)))
        except Exception:
            pair.say(Gone(f"the second process of this run failed:\n{traceback.format_exc()}"))


def learn_beside(pair: Pair, settings: TrainSettings[Any]) -> None:
    """Begin as the run does, with the other half of the games, and do what is asked."""
    prepare_torch(1, settings.seed)
    parts, state = parts_of(settings, pair.rank), pair.hear()
    torch.manual_seed(settings.seed)  # of the weights
    if state is not None:
        check("partner" in state, "of a run of one process")
        state = {"learner": state["learner"], **state["partner"]}
    env, teacher, learner = begin(parts, state)
    if state is None:
        apart = np.random.SeedSequence([settings.seed, pair.rank])
        torch.manual_seed(int(apart.generate_state(1, np.uint64)[0]))  # of the actions
    else:
        torch.set_rng_state(state["torch_rng"])
    learner.average = pair.average
    pair.say(digest_of(learner))
    while True:
        asked = pair.hear()
        if asked is None:
            if teacher is not None:
                teacher.figures()  # the log has those of the other; these must not pile up
            whole = state_in_play(env, teacher, learner)
            own = {name: whole[name] for name in IN_PLAY}
            pair.say(({**own, "torch_rng": torch.get_rng_state()}, digest_of(learner)))
            continue
        progress, seconds = asked
        if teacher is not None:
            teacher.update(progress, learner.frames * settings.processes, seconds)
        pair.say((learner.iterate(progress), env.finished_returns, env.finished_lengths))
        env.finished_returns.clear()
        env.finished_lengths.clear()


def digest_of(learner: Any) -> bytes:
    """Tells weights apart by their bits."""
    digest = hashlib.sha256()
    for weight in learner.network.parameters():
        digest.update(weight.detach().numpy().tobytes())
    return digest.digest()


def _check_same(digest: bytes, learner: Any) -> None:
    if digest != digest_of(learner):
        raise RuntimeError("the two processes of this run have come to different weights")
