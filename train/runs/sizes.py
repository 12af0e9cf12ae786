"""What a run needs of memory, at least: said before anything of it is taken."""

from __future__ import annotations

from math import prod
from typing import Any

from pursuit.memory import free_memory
from train.networks.policy import Player
from train.settings.algorithms import Hyperparameters

UNITS = ("bytes", "KB", "MB", "GB", "TB", "PB", "EB")


def bytes_of(hyper: Hyperparameters, seat: Player) -> dict[str, int]:
    """What a learner in this seat takes at least, in bytes, by the settings that it grows with."""
    given: dict[str, Any] = vars(hyper)
    observation = 4 * prod(seat.features.shape)
    game = seat.bytes_of_game + observation
    frame = 2 * observation + 32 + (4 * seat.num_actions if seat.continuous else 8)
    needs = {
        "num_games": hyper.num_games * game,
        "num_games × rollout_steps": hyper.num_games * given.get("rollout_steps", 0) * frame,
        "buffer_size": given.get("buffer_size", 0) * frame,
    }
    if "width" in given:
        width = given["width"]
        inputs = seat.features.num_rows or prod(seat.features.shape)
        if seat.features.kind == "planes" or seat.features.network:  # convolutions come before it
            inputs = 1
        weights = width * (inputs + width + seat.num_actions)
        if "tau" in given:  # an actor and a critic at least, and a target of each
            weights *= 4
        # Of each weight the gradient and Adam's two moments, or the candidates' own.
        needs["width"] = 4 * weights * 4
        needs["population × width"] = 2 * 4 * weights * given.get("population", 0)
    return needs


def check_memory(hyper: Hyperparameters, seat: Player) -> None:
    """Refuse what is beyond the free memory of this machine.

    Raises:
        ValueError: naming the bytes, and the settings that ask for most of them.
    """
    needs = bytes_of(hyper, seat)
    total, there = sum(needs.values()), free_memory()
    if total > there:
        most = max(needs, key=lambda names: needs[names])
        given = " × ".join(f"{name}={getattr(hyper, name)}" for name in most.split(" × "))
        raise ValueError(
            f"{given}: this run would take at least {in_units(total)} of memory, and this machine "
            f"has {in_units(there)} free; lower {most.replace(' × ', ' or ')}"
        )


def in_units(size: int) -> str:
    """A number of bytes, in the unit that suits it."""
    power = min((len(str(size)) - 1) // 3, len(UNITS) - 1)
    scaled = size / 1000**power if size < 10**30 else float("inf")
    return f"{scaled:,.3g} {UNITS[power]}" if scaled < 1000 else f"{scaled:,.0f} {UNITS[power]}"
