"""Rewards: what each role is paid, by coefficients, by a named scheme or by a user's function."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from pursuit.plugins import Registry
from pursuit.tasks.moments import ROLES as ROLES
from pursuit.tasks.moments import After, Before
from pursuit.validation import FrozenDict, check_fields, finite, flag

RewardFunction = Callable[[Before, Any, After], Any]
"""`f(before, actions, after)` -> [games, agents], what every agent is paid for the step.

`actions` is [games, agents] int32. It may be compiled by Numba: the two moments are NamedTuples of
arrays, copies that it may keep or change. Whoever had left the game before the step is paid
nothing, whatever it says.
"""


@dataclass(frozen=True)
class Rewards:
    """What one role is paid. The reward of an event replaces the step reward of that step.

    Attributes:
        step: every step without an event.
        capture: for a chaser, capturing an evader (captors of one evader share it equally); for an
            evader, being captured.
        goal: collecting a goal (those who arrive at once share it equally).
        distance: this times the Manhattan distance to the nearest active opponent (for a runner,
            to the nearest goal) is added to the step reward.
        on_completion: events pay only in the step that ends the game; before, they count as steps.
            Being captured always pays: it ends the game for that evader.
        per_evader: for chasers alone. In every step each chaser is paid the sum, over the evaders
            that were free before the step, of `capture` for an evader that is captured (by any
            chaser), `goal` for one that collects a goal (its share of it), and `step` for any
            other. Needs distance=0 and on_completion=False.

    Raises:
        ValueError: a value that is no finite number; `per_evader` with a distance or
            `on_completion`.
    """

    step: float = finite(0.0)
    capture: float = finite(0.0)
    goal: float = finite(0.0)
    distance: float = finite(0.0)
    on_completion: bool = flag(False)
    per_evader: bool = flag(False)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.per_evader and (self.distance != 0.0 or self.on_completion):
            raise ValueError(
                f"per_evader=True with distance={self.distance:g}, on_completion="
                f"{self.on_completion}; it needs distance=0 and on_completion=False: leave them out"
            )


REWARD_SCHEMES: Mapping[str, Mapping[str, Rewards]] = {
    "goal": {
        "chaser": Rewards(step=-0.1, capture=1.0),
        "evader": Rewards(step=1.0, capture=-1.0, goal=1.0),
        "runner": Rewards(step=-0.1, goal=1.0),
    },
    "completion": {
        "chaser": Rewards(step=-0.1, capture=1.0, on_completion=True),
        "evader": Rewards(step=1.0, capture=-1.0, goal=1.0, on_completion=True),
        "runner": Rewards(step=-0.1, goal=1.0, on_completion=True),
    },
    "distance": {
        "chaser": Rewards(distance=-1.0),
        "evader": Rewards(distance=1.0),
        "runner": Rewards(distance=-1.0),
    },
    "zero_sum": {
        "chaser": Rewards(step=-1.0, capture=-1.0, goal=-1.0, per_evader=True),
        "evader": Rewards(step=1.0, capture=1.0, goal=1.0),
        "runner": Rewards(step=-1.0, goal=-1.0),
    },
}
"""Rewards by scheme and role.

In `zero_sum` every step counts, the last one included: an evader that was free before the step is
paid 1 (its share of a goal where several collect one at once), and every chaser is paid minus the
sum of what the evaders are paid. So in each step the rewards of one chaser and of all evaders sum
to 0, and those of C chasers and all evaders to minus C - 1 times what the evaders are paid. In a
duel the return is the payoff of the exact game. A runner that is alone is paid minus the number of
steps; between runners nothing is zero-sum.
"""


def is_rewards(part: Any) -> bool:
    """Whether a part is a reward function, or `Rewards` by role."""
    if isinstance(part, Mapping):
        return set(part) <= set(ROLES) and all(
            isinstance(paid, Rewards) and (role == "chaser" or not paid.per_evader)
            for role, paid in part.items()
        )
    return callable(part) and not isinstance(part, type) and takes_three(part)


def takes_three(function: Callable[..., Any]) -> bool:
    """Whether three arguments fit a function; True where its arguments are not known."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # some functions written in C
        return True
    try:
        signature.bind(None, None, None)
    except TypeError:
        return False
    return True


REWARDS: Registry[Mapping[str, Rewards] | RewardFunction] = Registry(
    "rewards",
    "a function (before, actions, after) -> [games, agents], or pursuit.Rewards by role",
    is_rewards,
    plural="rewards",
    ours=tuple(REWARD_SCHEMES),
)
for _name, _scheme in REWARD_SCHEMES.items():
    REWARDS.register(_name, _scheme)


def is_coefficients(text: object) -> bool:
    """Whether a text is of the form `step=-0.1,capture=2`."""
    return isinstance(text, str) and "=" in text


def rewards_from_text(text: str) -> Mapping[str, Rewards]:
    """`Rewards` by role from `step=-0.1,capture=2` (for all roles), `chaser.step=-0.1`, or both.

    What is left out of a role that is named is 0; a role's own entries go before those for all.

    Raises:
        ValueError: an unknown role or coefficient, one given twice, or a value that is no number.
    """
    known = [field.name for field in fields(Rewards)]
    found: dict[str, dict[str, Any]] = {}
    for entry in filter(None, (part.strip() for part in text.split(","))):
        place, _, value = (part.strip() for part in entry.partition("="))
        role, _, name = place.rpartition(".")
        if role not in ("", *ROLES) or name not in known:
            raise ValueError(
                f"rewards={text!r}: no {place!r}; give {', '.join(known)}, for one role as in "
                f"chaser.step=-0.1 ({', '.join(ROLES)})"
            )
        if name in found.setdefault(role, {}):
            raise ValueError(f"rewards={text!r}: {place!r} is given twice; give it once")
        found[role][name] = _value_of(text, entry, name, value)
    if not found:
        raise ValueError(f"rewards={text!r}: empty; give step=-0.1,capture=2, say")
    named = ROLES if "" in found else [role for role in ROLES if role in found]
    return {role: Rewards(**{**found.get("", {}), **found.get(role, {})}) for role in named}


def _value_of(text: str, entry: str, name: str, value: str) -> float | bool:
    if name in ("on_completion", "per_evader"):
        if value.lower() not in ("true", "false"):
            raise ValueError(f"rewards={text!r}: {entry!r}; give true or false")
        return value.lower() == "true"
    try:
        return float(value)
    except ValueError:
        raise ValueError(f"rewards={text!r}: {entry!r}; give a number") from None


def rewards_text(given: Any) -> str:
    """One text for what files and options say of rewards: the same for the same coefficients.

    Args:
        given: a scheme, a `package.module:Name`, coefficients as text or as a table, with a table
            for each role or one for all.

    Raises:
        ValueError: something else, or coefficients that are none.
    """
    if isinstance(given, Mapping):
        entries = []
        for name, value in given.items():
            inner = value if isinstance(value, Mapping) else {"": value}
            entries += [f"{name}.{key}".rstrip(".") + f"={paid}" for key, paid in inner.items()]
        given = ",".join(entries) or "="
    if not is_coefficients(given):
        return str(given)
    by_role = rewards_from_text(given)
    same = len(by_role) == len(ROLES) and len(set(by_role.values())) == 1
    shown = {"": by_role[ROLES[0]]} if same else by_role
    return ",".join(
        f"{role}.{field.name}".lstrip(".") + f"={_plain(getattr(paid, field.name))}"
        for role, paid in shown.items()
        for field in fields(Rewards)
        if getattr(paid, field.name) or field.name == "step"
    )


def _plain(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value!r}".removesuffix(".0")


def check_rewards(name: str, given: Any) -> Any:
    """What `Task` keeps: a name as it is; `Rewards` by role as a dict that never changes.

    Raises:
        ValueError: an unknown name, role or coefficient, or something else altogether.
    """
    if isinstance(given, str):
        if not is_coefficients(given):
            REWARDS.get(given)
            return given
        given = rewards_from_text(given)
    if isinstance(given, Mapping):
        unknown = [role for role in given if role not in ROLES]
        if unknown:
            raise ValueError(f"{name} for {unknown}; the roles are {', '.join(ROLES)}")
        for role, paid in given.items():
            if not isinstance(paid, Rewards):
                raise ValueError(
                    f"{name} of the {role}: {paid!r}; give pursuit.Rewards(...) (a function is "
                    "given instead of the whole, and pays all roles)"
                )
            if paid.per_evader and role != "chaser":
                raise ValueError(
                    f"{name} of the {role}: per_evader=True; it is for chasers alone: leave it out"
                )
        return FrozenDict(given)
    if not is_rewards(given):
        raise ValueError(
            f"{name}={given!r}; give a scheme ({', '.join(REWARD_SCHEMES)}), Rewards by role, or a "
            "function (before, actions, after) -> [games, agents]"
        )
    try:
        hash(given)
    except TypeError:
        raise ValueError(f"{name}={given!r}; a reward function must hash, as tasks do") from None
    return given


def coefficients_of(kept: Any) -> Mapping[str, Rewards]:
    """The `Rewards` of every role; those of the scheme "goal" where a function pays instead."""
    found = REWARDS.get(kept) if isinstance(kept, str) else kept
    return {**REWARD_SCHEMES["goal"], **(found if isinstance(found, Mapping) else {})}


def function_of(kept: Any) -> RewardFunction | None:
    """The reward function, where there is one."""
    found = REWARDS.get(kept) if isinstance(kept, str) else kept
    return None if isinstance(found, Mapping) else found
