"""Rewards of each role: coefficients, named schemes, or a custom reward function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from pursuit.plugins import Registry, accepts
from pursuit.tasks.moments import ROLES as ROLES
from pursuit.tasks.moments import After, Before
from pursuit.tasks.pursuit_v5 import PursuitV5Rewards
from pursuit.validation import Flag, FrozenDict, Rule, check_fields, number

RewardFunction = Callable[[Before, Any, After], Any]
"""`f(before, actions, after)` -> [games, agents], the reward of every agent for the step.

`actions` is [games, agents] int32. `before` and `after` are NamedTuples of arrays, so the function
can be compiled by Numba; they are copies, which it may keep or change. Agents that had left the
game before the step always get a reward of 0.
"""


MOST_REWARD = 1e30
"""Rewards are float32: larger ones, times distances or summed up, could be infinite."""


def _coefficient(name: str, value: Any) -> float:
    coefficient = number(name, value)
    if abs(coefficient) > MOST_REWARD:
        raise ValueError(f"{name}={value}; rewards are float32: give at most {MOST_REWARD:g}")
    return coefficient


Coefficient = Annotated[float, Rule(_coefficient)]


@dataclass(frozen=True)
class Rewards:
    """Reward coefficients of one role. The reward of an event replaces the step reward.

    Attributes:
        step: reward of a step without an event.
        capture: for a chaser, the reward for capturing an evader (divided equally among its
            captors); for an evader, the reward for being captured.
        goal: reward for collecting a goal (divided equally among agents that reach it at once).
        distance: coefficient of the Manhattan distance to the nearest active opponent (for a
            runner, to the nearest goal), which is added to the step reward.
        on_completion: events are rewarded only in the step that ends the game; before it, they get
            the step reward. Being captured is always rewarded, as it ends the evader's episode.
        per_evader: chasers only. The reward of each chaser is a sum over the evaders that were free
            before the step: `capture` for an evader that is captured (by any chaser), `goal` for
            one that collects a goal (times its share), `escape` for one that escapes, and `step`
            for any other. Requires distance=0, touch=0 and on_completion=False.
        escape: for a chaser, the reward when an evader escapes; for an evader, the reward for
            escaping.
        touch: chasers only; added for every evader that is one move away after the chasers' moves.

    Raises:
        ValueError: a value that is not a number, or above `MOST_REWARD`; `per_evader` with a
            distance, `touch` or `on_completion`.
    """

    step: Coefficient = 0.0
    capture: Coefficient = 0.0
    goal: Coefficient = 0.0
    distance: Coefficient = 0.0
    on_completion: Flag = False
    per_evader: Flag = False
    escape: Coefficient = 0.0
    touch: Coefficient = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.per_evader and (self.distance != 0.0 or self.touch != 0.0 or self.on_completion):
            raise ValueError(
                f"per_evader=True with distance={self.distance:g}, touch={self.touch:g}, "
                f"on_completion={self.on_completion}; it requires distance=0, touch=0, "
                "on_completion=False: leave them out"
            )


_GOAL = {
    "chaser": Rewards(step=-0.1, capture=1.0, escape=-1.0),
    "evader": Rewards(step=1.0, capture=-1.0, goal=1.0, escape=1.0),
    "runner": Rewards(step=-0.1, goal=1.0),
}
REWARD_SCHEMES: Mapping[str, Mapping[str, Rewards]] = {
    "goal": _GOAL,
    "completion": {role: replace(each, on_completion=True) for role, each in _GOAL.items()},
    "distance": {
        "chaser": Rewards(distance=-1.0),
        "evader": Rewards(distance=1.0),
        "runner": Rewards(distance=-1.0),
    },
    "zero_sum": {
        "chaser": Rewards(step=-1.0, capture=-1.0, goal=-1.0, per_evader=True, escape=-1.0),
        "evader": Rewards(step=1.0, capture=1.0, goal=1.0, escape=1.0),
        "runner": Rewards(step=-1.0, goal=-1.0),
    },
    "win_loss": {
        "chaser": Rewards(capture=1.0, goal=-1.0, per_evader=True, escape=-1.0),
        "evader": Rewards(capture=-1.0, goal=1.0, escape=1.0),
        "runner": Rewards(goal=1.0),
    },
}
"""Rewards by scheme and role.

In `zero_sum` every step counts, including the last: the reward of an evader that was free before
the step is 1 (its share of a goal that several collect at once), and the reward of every chaser is
minus the sum of the rewards of the evaders. So the rewards of one chaser and all evaders sum to 0
in every step, and those of C chasers and all evaders to minus C - 1 times the rewards of the
evaders. In a duel the return is the payoff of the exact game. `win_loss` is zero-sum in the same
way: 1 for a capture, -1 for an escape, 0 for the end of time. The return of a single runner is
minus the number of steps; the game between several runners is not zero-sum.
"""


def is_rewards(part: Any) -> bool:
    """Whether `part` is a reward function, `PursuitV5Rewards` or a dict from role to `Rewards`."""
    if isinstance(part, Mapping):
        return set(part) <= set(ROLES) and all(
            isinstance(rewards, Rewards)
            and (role == "chaser" or not (rewards.per_evader or rewards.touch))
            for role, rewards in part.items()
        )
    if isinstance(part, PursuitV5Rewards):
        return True
    return callable(part) and not isinstance(part, type) and accepts(part, None, None, None)


REWARDS: Registry[Mapping[str, Rewards] | RewardFunction | PursuitV5Rewards] = Registry(
    "rewards",
    "a function (before, actions, after) -> [games, agents], or pursuit.Rewards by role",
    is_rewards,
    plural="rewards",
    ours=tuple(REWARD_SCHEMES),
)
for _name, _scheme in REWARD_SCHEMES.items():
    REWARDS.register(_name, _scheme)
REWARDS.register("pursuit_v5", PursuitV5Rewards())
REWARDS.register("pursuit_v5_local", PursuitV5Rewards(shared=False))


def is_coefficients(text: object) -> bool:
    """Whether `text` has the form `step=-0.1,capture=2`."""
    return isinstance(text, str) and "=" in text


def rewards_from_text(text: str) -> Mapping[str, Rewards]:
    """`Rewards` by role from `step=-0.1,capture=2` (all roles), `chaser.step=-0.1`, or both.

    Coefficients that are left out are 0. The entries of a role override those for all roles.

    Raises:
        ValueError: an unknown role or coefficient, a duplicate, or a value that is not a number.
    """
    known = [field.name for field in fields(Rewards)]
    by_role: dict[str, dict[str, Any]] = {}
    for entry in filter(None, (part.strip() for part in text.split(","))):
        place, _, value = (part.strip() for part in entry.partition("="))
        role, _, name = place.rpartition(".")
        if role not in ("", *ROLES) or name not in known:
            raise ValueError(
                f"rewards={text!r}: unknown {place!r}; give {', '.join(known)}, for one role as in "
                f"chaser.step=-0.1 ({', '.join(ROLES)})"
            )
        if name in by_role.setdefault(role, {}):
            raise ValueError(f"rewards={text!r}: {place!r} is given twice; give it once")
        by_role[role][name] = _value_of(text, entry, name, value)
    if not by_role:
        raise ValueError(f"rewards={text!r}: empty; give for example step=-0.1,capture=2")
    of_all = by_role.get("")
    named = [role for role in ROLES if of_all is not None or role in by_role]
    return {role: Rewards(**{**(of_all or {}), **by_role.get(role, {})}) for role in named}


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
    """The rewards of a file or option as text; equal coefficients give equal text.

    Args:
        given: a scheme, a `package.module:Name`, or coefficients as text or as a dict, one for
            each role or one for all.

    Raises:
        ValueError: anything else.
    """
    if isinstance(given, Mapping):
        entries = []
        for name, value in given.items():
            inner = value if isinstance(value, Mapping) else {"": value}
            entries += [f"{name}.{key}".rstrip(".") + f"={number}" for key, number in inner.items()]
        given = ",".join(entries) or "="
    if not is_coefficients(given):
        return str(given)
    by_role = rewards_from_text(given)
    same = len(by_role) == len(ROLES) and len(set(by_role.values())) == 1
    shown = {"": by_role[ROLES[0]]} if same else by_role
    return ",".join(
        f"{role}.{field.name}".lstrip(".") + f"={_plain(getattr(rewards, field.name))}"
        for role, rewards in shown.items()
        for field in fields(Rewards)
        if getattr(rewards, field.name) or field.name == "step"
    )


def _plain(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value!r}".removesuffix(".0")


def check_rewards(name: str, given: Any) -> Any:
    """The value of `Task.rewards`: a name unchanged; `Rewards` by role as an immutable dict.

    Raises:
        ValueError: an unknown name, role or coefficient, or another type.
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
        for role, rewards in given.items():
            if not isinstance(rewards, Rewards):
                raise ValueError(
                    f"{name} of the {role}: {rewards!r}; give pursuit.Rewards(...) (a "
                    "reward function replaces the whole dict)"
                )
            if (rewards.per_evader or rewards.touch) and role != "chaser":
                own = "per_evader=True" if rewards.per_evader else f"touch={rewards.touch:g}"
                raise ValueError(
                    f"{name} of the {role}: {own}; only chasers can have it: leave it out"
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
        raise ValueError(f"{name}={given!r}; a reward function must be hashable") from None
    return given
