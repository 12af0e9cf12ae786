"""The options of the rules of a task: captures, exits, collisions, slips; their checks.

The argument `task` of functions is a `pursuit.tasks.task.Task`, which imports this file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pursuit.mazes.maze import Maze
from pursuit.rules import layout
from pursuit.validation import FrozenDict, check, check_probability, is_int, is_number

MOVE_ORDERS = ("simultaneous", "chasers_first", "turns")
CAPTURES = ("cell", "adjacent", "surround")
"""The capture rules, in the order of their numbers in `pursuit.rules.layout`."""
CAPTURE_CHECKS = ("each_move", "after_chasers")
COLLISIONS = ("share", "block")
Slip = float | Mapping[str, float] | str


def check_slip(name: str, given: Any) -> Any:
    """The chance of slips: a number unchanged, by role or agent as an immutable dict.

    Raises:
        ValueError: a chance outside [0, 1], or another form.
    """
    if isinstance(given, str):
        given = _slip_from_text(name, given)
    if not isinstance(given, Mapping):
        return check_probability(name, given)
    return FrozenDict(
        {role: check_probability(f"{name} of {role}", share) for role, share in given.items()}
    )


def _slip_from_text(name: str, text: str) -> Any:
    """`0.1`, or a dict from `evader=0.1,chaser=0.2`."""
    try:
        if "=" not in text:
            return float(text)
        parts = [part.partition("=") for part in text.split(",")]
        shares = [(role.strip(), float(share)) for role, _, share in parts]
    except ValueError:
        rule = "give a probability, for roles or agents as in 'evader=0.1,chaser_0=0.2'"
        raise ValueError(f"{name}={text!r}; {rule}") from None
    if len(dict(shares)) < len(shares):
        raise ValueError(f"{name}={text!r}: a role is given twice; give it once")
    return dict(shares)


def slip_text(given: Slip) -> str:
    """The chance of slips as text, from which `check_slip` makes the same."""
    if isinstance(given, Mapping):
        return ",".join(f"{role}={slip_text(share)}" for role, share in given.items())
    return repr(float(given)).removesuffix(".0") if is_number(given) else str(given)


def slips_of(given: Slip, agent_names: Sequence[str], roles: Sequence[str]) -> tuple[float, ...]:
    """The chance of a slip of every agent.

    Raises:
        ValueError: an unknown role or agent.
    """
    if not isinstance(given, Mapping):
        return (float(given),) * len(agent_names)
    for name in given:
        if name not in (*agent_names, *roles):
            known = ", ".join(dict.fromkeys((*roles, *agent_names)))
            raise ValueError(f"slip of {name!r}; this task has {known}")
    named = zip(agent_names, roles, strict=True)
    return tuple(given.get(name, given.get(role, 0.0)) for name, role in named)


def check_exits(name: str, given: Any) -> tuple[int, ...]:
    """The cells of exits as a tuple.

    Raises:
        ValueError: no cells, or one that is given twice.
    """
    if isinstance(given, str):
        given = [int(cell) if cell.strip().isdigit() else cell for cell in given.split(",")]
    cells = tuple(given) if isinstance(given, Iterable) else (given,)
    if not cells or not all(is_int(cell) and cell >= 0 for cell in cells):
        raise ValueError(f"{name}={given!r}; give the numbers of one or more cells")
    if len(set(cells)) < len(cells):
        raise ValueError(f"{name}={given!r}: a cell is given twice; give it once")
    return tuple(map(int, cells))


def options_of(task: Any) -> layout.Options:
    """The options of the rules of a task, as used by `pursuit.rules`."""
    return layout.Options(
        CAPTURES.index(task.capture),
        task.n_catch,
        task.capture_check == "each_move",
        task.collisions == "block",
        task.move_order == "turns",
        any(task.slips),
        task.role_rewards["chaser"].touch != 0.0,
        task.num_exits or max(map(len, task.fixed_exits)),
    )


def check_options(task: Any) -> None:
    """Check that the options of the rules do not contradict each other.

    Raises:
        ValueError: they do.
    """
    slips_of(task.slip, task.agent_names, task.seat_roles)  # checks the names
    both = task.num_chasers > 0 and task.num_evaders > 0
    teams = f"num_chasers={task.num_chasers} and num_evaders={task.num_evaders}"
    for name, default in (
        ("capture", "cell"), ("n_catch", 1), ("capture_check", "each_move"),
    ):  # fmt: skip
        value = getattr(task, name)
        check(
            both or value == default,
            f"{name}={value!r}: captures need chasers and evaders, but {teams}; leave it out",
        )
    check(
        task.n_catch <= max(task.num_chasers, 1),
        f"n_catch={task.n_catch}, but num_chasers={task.num_chasers}, so no capture is possible; "
        "give at most the number of chasers",
    )
    check(
        task.capture != "surround" or task.n_catch == 1,
        f"capture='surround' with n_catch={task.n_catch}: the cells around the evader say how many "
        "chasers are needed; leave n_catch out",
    )
    check(
        task.capture_check == "each_move" or task.move_order != "simultaneous",
        "capture_check='after_chasers' with move_order='simultaneous': the chasers have no move of "
        "their own; give move_order='chasers_first' or 'turns'",
    )
    check(
        task.collisions == "share" or task.capture != "cell" or task.n_catch == 1,
        f"collisions='block' with capture='cell' and n_catch={task.n_catch}: chasers cannot share "
        "the evader's cell, so it cannot be captured; give capture='adjacent' or 'surround'",
    )
    if task.move_order == "turns":
        check(
            both, f"move_order='turns': chasers and evaders take turns, but {teams}; leave it out"
        )
        check(
            task.stay_action,
            "move_order='turns' with stay_action=False: the side that waits plays stay; give "
            "stay_action=True",
        )
    check(
        not task.num_runners or task.move_order != "turns",
        f"move_order='turns' with num_runners={task.num_runners}; take 'chasers_first'",
    )
    given = task.exits is not None or task.num_exits > 0
    check(
        not given or task.num_evaders > 0,
        f"exits={task.exits}, num_exits={task.num_exits}, but num_evaders=0 and only evaders "
        "escape; give num_evaders, or leave the exits out",
    )
    check(
        task.exits is None or task.num_exits == 0,
        f"exits={task.exits} and num_exits={task.num_exits}; give one of them",
    )
    for maze, cells in zip(task.mazes, task.fixed_exits, strict=True):
        _check_exits_in(task, maze, cells)


def _check_exits_in(task: Any, maze: Maze, cells: tuple[int, ...]) -> None:
    for cell in cells:
        check(
            cell < maze.num_cells,
            f"exits={cells}: the cells of {maze.name} are 0 to {maze.num_cells - 1}",
        )
        check(
            task.start != "marks" or (cell != maze.start_mark and cell not in maze.goal_marks),
            f"exits={cells}: cell {cell} of {maze.name} is marked as start or goal; take another, "
            "or start='random'",
        )
    count = task.num_exits or len(cells)
    check(
        not task.num_exits or not maze.exit_marks,
        f"num_exits={task.num_exits}, but {maze.name} has exits marked E; leave num_exits out",
    )
    # Goals are drawn last, so cells must remain for them wherever the agents and exits are.
    agents = task.num_agents if task.num_goals else task.num_evaders
    check(
        not count or agents + count + task.num_goals <= maze.num_cells,
        f"{count} exits, {agents} {'agents' if task.num_goals else 'evaders'} and "
        f"{task.num_goals} goals need different cells; maze {maze.name} has {maze.num_cells}. Use "
        "fewer, or a larger maze",
    )
