"""The software and the machine of a run, for `results.json`."""

from __future__ import annotations

import os
import platform

import torch

import pursuit
from train.files import Plain
from train.machine import commit, processor


def versions() -> Plain:
    """The versions of the software."""
    return {
        "pursuit": pursuit.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "commit": commit(),
    }


def machine() -> Plain:
    """The machine and its threads."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
    }
