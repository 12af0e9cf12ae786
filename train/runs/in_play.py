"""A learner in its training games: begun, saved, and put back to where it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from train.runs.memories import memories_of, put_memories
from train.runs.parts import Parts
from train.teaching.teacher import Teacher
from train.tensors import Misfit, check_like


def begin(parts: Parts, state: dict[str, Any] | None) -> tuple[Any, Teacher | None, Any]:
    """The games, who teaches in them and the learner, where `state_in_play` left them; None begins.

    Raises:
        One of `MISFITS`: a state of other settings.
    """
    env, teacher = parts.games()
    if state is not None:  # before there is a collector, which begins with what it finds
        put_games(env.simulator, state.get("simulator"), "trainee.simulator")
        if teacher is not None:
            teacher.load_state_dict(state["teacher"])
        put_memories(env, state.get("memories"), "trainee.memories")
        env.resume = True
    learner = parts.algorithm.build(parts.hyper, env, parts.build)
    if state is not None:
        check_like(state.get("learner"), learner.state_dict(), "trainee.learner")
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


def put_games(simulator: Any, saved: Any, where: str) -> None:
    """Put what `plain_games` gave of such games into `simulator`, which checks what it takes.

    Raises:
        Misfit: it is something else, or a game in it is none that can be played on.
    """
    fresh = plain_games(simulator)
    if isinstance(saved, dict) and "collected" in fresh:  # older checkpoints do not hold it
        saved = {"collected": torch.zeros_like(fresh["collected"]), **saved}
    check_like(saved, fresh, where)
    arrays = {name: tensor.numpy() for name, tensor in saved.items()}
    form = type(simulator.get_state())
    state = form(**{**arrays, "streams": arrays["streams"].view(np.uint64)})
    try:
        simulator.set_state(state)
    except ValueError as error:
        raise Misfit(f"{where}: {error}") from None
