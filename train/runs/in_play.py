"""A learner in its training games: begun, saved, and put back to where it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from train.runs.folder import check_learned
from train.runs.memories import memories_of, put_memories
from train.runs.parts import Parts
from train.settings.checks import check
from train.teaching.teacher import Teacher


def begin(parts: Parts, state: dict[str, Any] | None) -> tuple[Any, Teacher | None, Any]:
    """The games, who teaches in them and the learner, where `state_in_play` left them; None begins.

    Raises:
        One of `MISFITS`: a state of other settings.
    """
    if state is not None:
        check_learned(parts.algorithm.name, state)
    env, teacher = parts.games()
    if state is not None:  # before there is a collector, which begins with what it finds
        put_games(env.simulator, state["simulator"])
        if teacher is not None:
            teacher.load_state_dict(state["teacher"])
        put_memories(env, state["memories"])
        env.resume = True
    learner = parts.algorithm.build(parts.hyper, env, parts.build)
    if state is not None:
        check(state["learner"].keys() == learner.state_dict().keys(), "of another learner")
        learner.load_state_dict(state["learner"])
    return env, teacher, learner


def state_in_play(env: Any, teacher: Teacher | None, learner: Any) -> dict[str, Any]:
    """Learner, teacher and games, with what is remembered of them."""
    return {
        "learner": learner.state_dict(),
        "teacher": None if teacher is None else teacher.state_dict(),
        "simulator": plain_games(env.simulator),
        "memories": memories_of(env),
    }


def plain_games(simulator: Any) -> dict[str, torch.Tensor]:
    """The state of the games for a checkpoint: torch has few operations on uint64, so the bits of
    the random streams travel as int64."""
    return {
        name: torch.from_numpy(array.view(np.int64) if array.dtype == np.uint64 else array)
        for name, array in vars(simulator.get_state()).items()
    }


def put_games(simulator: Any, saved: dict[str, torch.Tensor]) -> None:
    """Put what `plain_games` gave of such games into `simulator`, which checks what it takes."""
    arrays = {name: tensor.numpy() for name, tensor in saved.items()}
    form = type(simulator.get_state())
    simulator.set_state(form(**{**arrays, "streams": arrays["streams"].view(np.uint64)}))
