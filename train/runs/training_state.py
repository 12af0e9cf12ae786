"""The state of training: environment, teacher and learner, built, saved and restored."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.simulator.batch import Batch
from pursuit.validation import check
from train.algorithms.learner import Learner
from train.algorithms.registry import build_learner
from train.files import Plain
from train.runs.folder import MISFITS, check_learned, load_checkpoint
from train.runs.parts import Parts
from train.runs.saved import load_settings
from train.settings.algorithms import Hyperparameters
from train.teaching.teacher import Teacher

if TYPE_CHECKING:  # slow to import
    from train.environments.batch_env import BatchEnv
    from train.environments.vector_env import LearnerVectorEnv

    AnyEnv = BatchEnv | LearnerVectorEnv

FINISHED = ("returns", "lengths")
"""What is saved of the training episodes since the last evaluation."""


def build_env_and_learner(
    parts: Parts, state: Plain | None
) -> tuple[AnyEnv, Teacher | None, Learner]:
    """The environment, the teacher and the learner: new, or restored from a `training_state`.

    Raises:
        One of `MISFITS`: a state of other settings.
    """
    if state is not None:
        check_learned(parts.algorithm.name, state, parts.seat)
    env, teacher = parts.games(0 if state is None else state["learner"].get("frames", 0))
    if state is not None:  # before the collector of the learner reads the environment
        restore_simulator(env.simulator, state["simulator"])
        if teacher is not None:
            teacher.load_state_dict(state["teacher"])
        env.finished_returns, env.finished_lengths = (
            [tensor.numpy() for tensor in state.get("finished", {}).get(name, ())]
            for name in FINISHED
        )
        restore_policy_memories(env, state["memories"])
        env.resume = True
    learner = build_learner(parts.algorithm, parts.hyper, env, parts.build)
    if state is None:
        start_weights(learner, parts.hyper, parts.settings.init_from)
    else:
        found, needed = set(state["learner"]), set(learner.state_dict())
        check(found == needed, f"the learner's state has {sorted(found)}, not {sorted(needed)}")
        learner.load_state_dict(state["learner"])
    return env, teacher, learner


def start_weights(learner: Learner, hyper: Hyperparameters, source: str | None) -> None:
    """Give a new learner the weights of the saved policy in the folder `source`; None for none.

    Args:
        learner: new.
        hyper: its hyperparameters.
        source: the folder.

    Raises:
        ValueError: there is no policy, or one with another network.
    """
    if source is None:
        return
    before = load_settings(source)  # it is a policy, whose parts are allowed
    state = load_checkpoint(source)["trainee"]["learner"]
    here, there = (
        {name: tuple(weights.shape) for name, weights in each.get("network", {}).items()}
        for each in (learner.state_dict(), state)
    )
    other = [name for name in {**here, **there} if here.get(name) != there.get(name)]
    where = f"init_from={source!r}: its network does not fit"
    remedy = "give a run with the same observation, network and width, or change these here"
    for name in other[:1]:
        sizes = f"{there.get(name, 'missing')} there and {here.get(name, 'missing')} here"
        raise ValueError(f"{where}: {name} is {sizes}; {remedy}")
    activations = [getattr(each, "activation", None) for each in (before.hyper, hyper)]
    check(
        activations[0] == activations[1],
        f"{where}: activation is {activations[0]} there and {activations[1]} here; give the same",
    )
    try:
        learner.start_from(state)
    except MISFITS as error:
        raise ValueError(f"{where} ({' '.join(str(error).split())[:200]}); {remedy}") from None


def training_state(env: AnyEnv, teacher: Teacher | None, learner: Learner) -> Plain:
    """The state of learner, teacher and games, with the memories of policies."""
    return {
        "learner": learner.state_dict(),
        "teacher": None if teacher is None else teacher.state_dict(),
        "simulator": simulator_tensors(env.simulator),
        "memories": policy_memories(env),
        "finished": {
            name: [torch.from_numpy(array) for array in getattr(env, f"finished_{name}")]
            for name in FINISHED
        },
    }


def simulator_tensors(simulator: Batch[Any]) -> dict[str, torch.Tensor]:
    """The state of the games for a checkpoint; random streams are stored as int64, as torch has
    few operations on uint64."""
    state = vars(simulator.get_state())
    return {name: torch.from_numpy(_plain(array)) for name, array in state.items()}


def restore_simulator(simulator: Batch[Any], saved: dict[str, torch.Tensor]) -> None:
    """Restore the state of `simulator` from `simulator_tensors`; the simulator checks it."""
    arrays = {name: tensor.numpy() for name, tensor in saved.items()}
    form = type(simulator.get_state())
    simulator.set_state(form(**{**arrays, "streams": arrays["streams"].view(np.uint64)}))


# -- memories of policies during an episode -------------------------------------------------------

Memories = dict[str, dict[str, torch.Tensor]]


def policy_memories(env: AnyEnv) -> Memories:
    """Copies of all memories, by agent index (and opponent) and name."""
    return {
        place: {name: torch.from_numpy(_plain(array).copy()) for name, array in arrays.items()}
        for place, arrays in _arrays(env)
    }


def restore_policy_memories(env: AnyEnv, saved: Memories) -> None:
    """Restore `policy_memories` of such an environment, before it is stepped.

    Opponents that are missing here are ignored; new ones start with an empty memory.
    """
    for place, arrays in _arrays(env):
        if place in saved:
            for name, array in arrays.items():
                _plain(array)[:] = saved[place][name].numpy()


def _arrays(env: Any) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """The memory arrays in use, by agent index (and opponent)."""
    if env.stack is not None:
        yield "stack", {"frames": env.frames}
    for seat, policy in enumerate(env.policies):
        # A pool of opponents lists its members with memory.
        several = getattr(policy, "recurrent_members", None)
        found: dict[str, Any] = {"": policy} if hasattr(policy, "memory") else {}
        for name, one in (found if several is None else several()).items():
            yield f"{seat} {name}".strip(), one.memory.of(env.simulator.view(seat))


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """An array with uint64 viewed as int64, as torch has few operations on uint64."""
    return array.view(np.int64) if array.dtype == np.uint64 else array
