"""Policies of learners outside of this package, which a `Tracker` records: functions of
observations. What is saved of one is its values where it was evaluated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from pursuit.validation import check, raised
from train.algorithms.learner import Build
from train.environments.batch_env import BatchEnv
from train.networks.distributions import are_probabilities
from train.networks.seat import Seat
from train.settings.algorithms import TrackedSettings
from train.tensors import StateDict

TrackedPolicy = Callable[[NDArray[Any]], Any]
"""Actions [n], or probabilities [n, actions], of observations [n, *shape]; turns [n, joints] of an
arm with continuous actions."""

LEAST = 1e-30
"""Probabilities below this one count as this one: a logit must be finite."""


class NotSavedError(ValueError):
    """Of a tracked policy only its actions where it was evaluated are saved."""


def no_policy(observations: NDArray[Any]) -> NDArray[Any]:
    """The policy before the first one."""
    raise NotSavedError("a tracked run is trained by its script; repeat the script")


class TrackedNetwork(nn.Module):
    """A function of observations as the network of a seat.

    Attributes:
        seen: the observations so far in bytes, with what the function returned.
    """

    def __init__(self, seat: Seat, function: TrackedPolicy) -> None:
        super().__init__()
        self.seat, self.function = seat, function
        self.seen: dict[bytes, tuple[NDArray[Any], NDArray[np.float64]]] = {}
        self.place = nn.Parameter(torch.zeros(()), requires_grad=False)  # networks have a device

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] of [..., *shape]."""
        shape = self.seat.features.shape
        flat = observation.numpy().reshape(-1, *shape)
        found = torch.from_numpy(np.log(np.maximum(self.answer(flat), LEAST)))
        return found.reshape(*observation.shape[: -len(shape)], -1)

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None) -> torch.Tensor:
        """[n, joints] of [n, *shape]; `noise` has no effect."""
        return torch.from_numpy(self.answer(observation.numpy()))

    def answer(self, observations: NDArray[Any]) -> NDArray[np.float64]:
        """[n, actions] float64 of [n, *shape]: probabilities, or turns of joints.

        Each observation is asked once, so that all results are of one policy.

        Raises:
            ValueError: the function failed, or returned anything else; or it draws its actions.
        """
        keys = [row.tobytes() for row in observations]
        new = [place for place, key in enumerate(keys) if key not in self.seen]
        if new:
            asked = observations[new]
            found = self._asked(asked)
            fixed = bool(self.seen) or np.allclose(found, self._asked(asked), atol=1e-3)
            check(
                fixed,
                "the policy answers the same observations differently; give probabilities, or "
                "actions that are not drawn (predict(..., deterministic=True))",
            )
            pairs = zip(new, asked, found, strict=True)
            self.seen |= {keys[place]: (row, own) for place, row, own in pairs}
        return np.array([self.seen[key][1] for key in keys])

    def _asked(self, observations: NDArray[Any]) -> NDArray[np.float64]:
        """What the function returns, checked."""
        try:
            found = np.asarray(self.function(observations))
        except NotSavedError:
            raise
        except Exception as error:  # the function may raise anything
            raise ValueError(f"the policy raised {raised(error)}; mend it") from error
        count, actions, continuous = len(observations), self.seat.num_actions, self.seat.continuous
        if not continuous and found.shape == (count,) and found.dtype.kind in "iu":
            check(
                bool(((found >= 0) & (found < actions)).all()),
                f"the policy returned actions from {found.min()} to {found.max()}; give 0 to "
                f"{actions - 1}",
            )
            found = np.eye(actions)[found]
        wanted = f"probabilities [{count}, {actions}], or whole numbers [{count}]"
        check(
            found.shape == (count, actions) and found.dtype.kind == "f",
            f"the policy returned {found.dtype} of shape {list(found.shape)} for {count} "
            f"observations; give {f'turns [{count}, {actions}]' if continuous else wanted}",
        )
        fits, rule = bool(np.isfinite(found).all()), "finite turns"
        if not continuous:
            fits, rule = are_probabilities(found), "probabilities of sum 1"
        check(fits, f"the policy returned numbers that are no {rule}; mend it")
        return found.astype(np.float64)


class TrackedLearner:
    """The place of a learner in a run that a `Tracker` writes; it does not learn.

    Args:
        settings: none have an effect.
        env: the games, for the seat.
        options: none have an effect.

    Attributes:
        frames: those of the last policy.
        network: the last policy.
        complete: whether it was asked in all situations.
    """

    def __init__(self, settings: TrackedSettings, env: BatchEnv, options: Build) -> None:
        self.frames, self.seat, self.complete = 0, env.player, False
        self.network = TrackedNetwork(self.seat, no_policy)

    def iterate(self, progress: float) -> dict[str, float]:
        """ValueError: nothing is trained here."""
        no_policy(np.empty(0))
        return {}

    def policy(self, greedy: bool = True) -> Any:
        """The last policy as it was given."""
        return self.seat.policy(self.network, greedy=False)

    def state_dict(self) -> StateDict:
        """The frames, and the policy where it was evaluated."""
        rows = [*self.network.seen.values()]
        seen, returned = (np.array([row[part] for row in rows]) for part in (0, 1))
        own = {"observations": torch.from_numpy(seen), "returned": torch.from_numpy(returned)}
        return {**own, "complete": self.complete, "frames": self.frames}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        self.network, self.complete = saved_network(self.seat, state), state["complete"]
        self.frames = state["frames"]

    def start_from(self, state: StateDict) -> None:
        """ValueError: as `iterate`."""
        self.iterate(0.0)

    def close(self) -> None:
        """Nothing to release."""


def saved_network(seat: Seat, state: StateDict) -> TrackedNetwork:
    """The policy in a `TrackedLearner.state_dict`: it knows the observations of its evaluation."""
    observations, returned = state["observations"].numpy(), state["returned"].numpy()
    known = {row.tobytes(): place for place, row in enumerate(observations)}

    def saved(asked: NDArray[Any]) -> NDArray[Any]:
        places = np.array([known.get(row.tobytes(), -1) for row in asked], dtype=np.int64)
        missing = places < 0
        if missing.any() and not state["complete"]:
            raise NotSavedError(
                "of a tracked policy only its actions where it was evaluated are saved, by sampled "
                "episodes here, and this is another situation; give the model itself"
            )
        # Where all situations are known, the others are those of games that have ended.
        return np.where(missing[:, None], 1.0 / seat.num_actions, returned[places])

    return TrackedNetwork(seat, saved)


def load(settings: TrackedSettings, seat: Seat, state: StateDict, greedy: bool = True) -> Any:
    """The policy in a `TrackedLearner.state_dict`."""
    return seat.policy(saved_network(seat, state), greedy=False)
