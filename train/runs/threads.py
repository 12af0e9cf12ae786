"""Configuration of torch on this machine: threads, memory and random states."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import torch

from pursuit.validation import check
from train.files import Plain


def prepare_torch(threads: int, seed: int) -> None:
    """Configure memory, `threads` (0: one per core) and seed, before anything is built."""
    keep_freed_memory()
    torch.set_num_threads(threads or os.cpu_count() or 1)
    torch.manual_seed(seed)


def keep_freed_memory() -> None:
    """Make the C library keep freed blocks of a minibatch's size instead of returning them.

    Mapping and clearing such blocks again in every gradient step took a tenth of the time. Without
    effect where the C library is not glibc.
    """
    mmap_threshold, trim_threshold = -3, -1  # the numbers of mallopt(3)
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    mallopt(mmap_threshold, 2**30)
    mallopt(trim_threshold, 2**31 - 1)


def can_fork() -> bool:
    """Whether this process can fork: it runs on Linux, with one thread and no open GPU."""
    try:
        threads = len(os.listdir("/proc/self/task"))
        opened = [os.path.realpath(path) for path in Path("/proc/self/fd").iterdir()]
    except OSError:
        return False
    return threads == 1 and not any(path.startswith("/dev/nvidia") for path in opened)


def random_states() -> Plain:
    """The states of torch's generators for a checkpoint: "torch_rng", and "cuda_rng" with one for
    each GPU (empty if this process has used none)."""
    used = torch.cuda.is_available() and torch.cuda.is_initialized()  # type: ignore[no-untyped-call]
    return {
        "torch_rng": torch.get_rng_state(),
        "cuda_rng": torch.cuda.get_rng_state_all() if used else [],
    }


def set_random_states(state: Plain) -> None:
    """Restore `random_states`, without those of GPUs that do not exist here."""
    torch.set_rng_state(state["torch_rng"])
    here = torch.cuda.device_count() if torch.cuda.is_available() else 0
    for device, own in enumerate(state.get("cuda_rng", [])[:here]):
        torch.cuda.set_rng_state(own, device)


def check_device(device: str) -> None:
    """ValueError for a GPU that torch does not find."""
    if device == "cpu":
        return
    here = torch.cuda.device_count() if torch.cuda.is_available() else 0
    check(
        here > 0,
        f"device={device!r}, but torch finds no GPU; use --device cpu (a run that began on a "
        "GPU is resumed where there is one)",
    )
    found = "one GPU; use --device cuda"
    if here > 1:
        found = f"{here} GPUs; use --device cuda:0 to cuda:{here - 1}"
    check(int(device.partition(":")[2] or 0) < here, f"device={device!r}, but torch finds {found}")


class ThreadChoice:
    """Chooses between one thread and all of them, by the time of rollouts with each.

    Threads wait for each other in every operation. Several threads are faster on idle cores; one
    thread is up to ten times faster if other programs use a core. So the other choice is tried in
    two of every 24 rollouts.

    Args:
        most: number of all threads.
    """

    PERIOD = 24

    def __init__(self, most: int) -> None:
        self.most, self.count = most, 0
        self.seconds = {1: 0.0, most: 0.0}
        self.current = self.preferred = most

    def choose(self) -> None:
        """Set torch's threads for the next rollout."""
        if self.count % self.PERIOD < 2:
            self.current = 1 if self.preferred == self.most else self.most
        else:
            self.current = self.preferred
        torch.set_num_threads(self.current)

    def learn(self, seconds: float) -> None:
        """Record the time of that rollout; the first one after a change is ignored."""
        if self.count % self.PERIOD != 0:
            before = self.seconds[self.current]
            self.seconds[self.current] = 0.5 * (before + seconds) if before else seconds
        self.count += 1
        if all(self.seconds.values()):
            self.preferred = min(self.seconds, key=lambda threads: self.seconds[threads])
