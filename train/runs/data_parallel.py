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
from train.runs.folder import CHECKPOINT
from train.runs.in_play import begin, state_in_play
from train.runs.parts import parts_of
from train.runs.threads import can_fork, prepare_torch
from train.settings.checks import check
from train.settings.run import TrainSettings

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
    """

    def __init__(self, connection: Any, shared: Any, rank: int) -> None:
        self.connection, self.rank = connection, rank
        # Two slots each, in turns: whoever is ahead must not write where the other may still read.
        # Two turns later it may: the other has spoken since, and so has read.
        self.slots = torch.frombuffer(shared, dtype=torch.float32).view(2, 2, -1)
        self.turn = 0

    def say(self, content: Any) -> None:
        """Tell the other; where it has ended, `hear` says so."""
        with contextlib.suppress(OSError):
            # torch has multiprocessing's own pickling put tensors into shared memory with names
            self.connection.send_bytes(pickle.dumps(content))

    def hear(self) -> Any:
        """What the other says next; Gone where it has ended, its error where it has failed."""
        try:
            content = pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError):
            raise Gone(self.how_it_ended()) from None
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

    def how_it_ended(self) -> str:
        """What is known of the end of the other."""
        return "the process of the run has ended"


class Partner(Pair):
    """The second process, as that of the run sees it.

    It is forked where this process has one thread, which takes no time, and started anew elsewhere,
    where it imports torch first, which takes seconds.

    Args:
        settings: of the run.
        learner: here; it learns with the partner from now on.
        folder: of the run.
        state: of the trainee in a checkpoint; None begins.

    Raises:
        Gone: it could not be started.
        ValueError: a checkpoint of one process.
    """

    def __init__(
        self,
        settings: TrainSettings[Any],
        learner: Any,
        folder: Path,
        state: dict[str, Any] | None = None,
    ) -> None:
        context: Any = get_context("fork" if can_fork() else "spawn")
        weights = sum(weight.numel() for weight in learner.network.parameters())
        shared = context.RawArray("f", 4 * weights)
        ours, theirs = context.Pipe()
        super().__init__(ours, shared, 0)
        self.folder, self.learner = folder, learner
        given = (ours, theirs, shared, settings, environment())
        self.process = context.Process(target=serve, args=given, name="partner", daemon=True)
        self.process.start()
        theirs.close()
        self.close = Finalize(self, end, (ours, self.process), exitpriority=0)
        self.say(state)
        try:
            self.check_same(self.hear())
        except Exception:
            self.close()
            raise
        learner.average = self.average

    def iterate(
        self, progress: float, seconds: float
    ) -> tuple[dict[str, float], list[NDArray[Any]], list[NDArray[Any]]]:
        """An iteration of both: the figures, and the returns and lengths of the episodes that
        ended in the games of the partner."""
        self.say((progress, seconds))
        figures = self.learner.iterate(progress)
        others, returns, lengths = self.hear()
        both = {name: 0.5 * (value + others[name]) for name, value in figures.items()}
        return both, returns, lengths

    def state(self) -> dict[str, Any]:
        """What a checkpoint needs of it; its weights are those of the learner here.

        Raises:
            RuntimeError: they are not.
        """
        self.say(None)
        state, digest = self.hear()
        self.check_same(digest)
        found: dict[str, Any] = state
        return found

    def check_same(self, digest: bytes) -> None:
        """RuntimeError for other weights than those here."""
        if digest != digest_of(self.learner):
            raise RuntimeError("the two processes of this run have come to different weights")

    def how_it_ended(self) -> str:
        """How, and what can be done."""
        told = "the second process of this run has ended"
        self.process.join(AT_ONCE)
        code = self.process.exitcode
        if code == 1:  # multiprocessing has printed why
            return f"{told}: see above. A script that starts it needs `if __name__ == '__main__':`"
        if code is not None and code < 0:
            told += f", killed by signal {-code} ({signal.Signals(-code).name})"
        if not (self.folder / CHECKPOINT).exists():
            return f"{told}; it has no checkpoint yet: begin it anew"
        return f"{told}; its last checkpoint is kept: go on from there by --resume"


def end(connection: Any, process: Any) -> None:
    """End the partner, which has nothing to save; Python does so, too, when nobody has it."""
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
    try:
        learn_beside(pair, settings)
    except Gone:
        return
    except ValueError as error:
        pair.say(ValueError(str(error)))
    except Exception:
        pair.say(Gone(f"the second process of this run failed:\n{traceback.format_exc()}"))


def learn_beside(pair: Pair, settings: TrainSettings[Any]) -> None:
    """Begin as the run does, with the other half of the games, and do what is asked."""
    prepare_torch(1, settings.seed)
    parts, state = parts_of(settings, pair.rank), pair.hear()
    if state is None:
        env, teacher, learner = begin(parts, None)
        apart = np.random.SeedSequence([settings.seed, pair.rank])
        torch.manual_seed(int(apart.generate_state(1, np.uint64)[0]))  # of the actions
    else:
        check("partner" in state, "of a run of one process")
        env, teacher, learner = begin(parts, {**state, **state["partner"]})
        torch.set_rng_state(state["partner"]["torch_rng"])
    learner.average = pair.average
    pair.say(digest_of(learner))
    while True:
        asked = pair.hear()
        if asked is None:
            if teacher is not None:
                teacher.figures()  # the log has those of the other; these must not pile up
            own = {**state_in_play(env, teacher, learner), "torch_rng": torch.get_rng_state()}
            del own["learner"]
            pair.say((own, digest_of(learner)))
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
