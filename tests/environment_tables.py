"""The tables of the pages of environments, rules, the API and exact solutions, made of the code:
signatures, docstrings, spaces, rewards, options, names, references, limits.

    PYTHONPATH=. python tests/environment_tables.py      # writes them anew into docs/

A page holds a table between `<!-- table: NAME -->` and `<!-- end -->`; a test compares.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, fields
from enum import Enum
from importlib import import_module
from inspect import Parameter, getdoc, signature
from pathlib import Path
from typing import Any

import docstring_parser
import gymnasium

import pursuit
from pursuit.environments.parallel import PursuitParallelEnv
from pursuit.environments.single_agent import SingleAgentVectorEnv
from pursuit.observations.observations import ENCODINGS, Encoder
from pursuit.reacher.parallel_env import ReacherParallelEnv
from pursuit.tasks.options import CAPTURE_CHECKS, CAPTURES, COLLISIONS, MOVE_ORDERS
from pursuit.tasks.rewards import REWARD_SCHEMES, ROLES, Rewards
from scripted_agents import environments
from scripted_agents.exact import limits as limits_module
from scripted_agents.exact.references import ARMS, MAZES, SMALL_GAMES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PLACE = re.compile(r"(<!-- table: ([\w -]+) -->\n).*?(<!-- end -->)", re.DOTALL)
GYMNASIUM = {
    "chase": ("Chaser", "Evader"),
    "maze": ("Maze",),
    "race": ("Race",),
    "heist": ("HeistChaser", "HeistEvader"),
    "escape": ("EscapeChaser", "EscapeEvader"),
    "reacher": ("Reacher",),
}


def pages() -> list[str]:
    """The pages that hold tables."""
    found = [page for page in DOCS.rglob("*.md") if PLACE.search(page.read_text(encoding="utf-8"))]
    return sorted(str(page.relative_to(ROOT)) for page in found)


def renewed(text: str) -> str:
    """A page's text with its tables as they are now."""

    def table(place: re.Match[str]) -> str:
        kind, _, name = place[2].partition(" ")
        return f"{place[1]}\n{TABLES[kind](name)}\n\n{place[3]}"

    return PLACE.sub(table, text)


def rows(head: tuple[str, ...], body: list[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    lines = [head, ("---",) * len(head), *body]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def module_of(name: str) -> Any:
    """The PettingZoo module of a task."""
    return getattr(pursuit, f"{name}_v0")


# -- arguments -------------------------------------------------------------------------------------


def described(*sources: Any) -> dict[str, str]:
    """What docstrings say of arguments, by name; the first that says something counts."""
    found: dict[str, str] = {}
    for source in sources:
        for parameter in docstring_parser.parse(
            source.__doc__ or "", docstring_parser.DocstringStyle.GOOGLE
        ).params:
            for name in re.split(r",\s*", parameter.arg_name):
                found.setdefault(name, " ".join((parameter.description or "").split()))
    return found


def own_parameters(*functions: Callable[..., Any]) -> dict[str, Any]:
    """The arguments of functions that have a default, with it."""
    found: dict[str, Any] = {}
    for function in functions:
        for name, parameter in signature(function).parameters.items():
            if parameter.default is not Parameter.empty:
                found.setdefault(name, parameter.default)
    return found


def settings_of(task: Any) -> dict[str, Any]:
    """The settings of a task, as they stand by default."""
    return {field.name: getattr(task, field.name) for field in fields(task) if field.name != "name"}


def plain(value: Any) -> str:
    """A default as one would write it."""
    if isinstance(value, Rewards):
        given = [f for f in fields(value) if getattr(value, f.name) != _default(f)]
        return f"Rewards({', '.join(f'{f.name}={getattr(value, f.name)!r}' for f in given)})"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{plain(key)}: {plain(part)}" for key, part in value.items()) + "}"
    return str(value) if isinstance(value, Enum) else repr(value).replace("'", '"')


def _default(field: Any) -> Any:
    return None if field.default is MISSING else field.default


def argument_rows(given: dict[str, Any], texts: dict[str, str], of_rules: Sequence[str]) -> str:
    """Every argument with its default and what its docstring says; those of one text in one row.
    What another page defines has a link; the options of the rules have one row."""
    silent = [name for name in given if not texts.get(name)]
    assert not silent, f"no docstring describes {silent}; add them to an `Args:` section"
    texts = {**texts, **LINKED}
    texts |= dict.fromkeys(of_rules, f"[options of the rules]({RULES}#options).")
    by_text: dict[str, list[str]] = {}
    for name in given:
        by_text.setdefault(texts[name], []).append(name)
    body = []
    for text, names in by_text.items():
        defaults = [] if names[0] in of_rules else [f"`{plain(given[name])}`" for name in names]
        body.append((", ".join(f"`{name}`" for name in names), ", ".join(defaults), text))
    return rows(("argument", "default", "meaning"), body)


RULES = "../explanation/rules.md"
LINKED = {
    "rewards": "a [name](mazes.md#rewards), a dict from role to `Rewards`, or [your own]"
    "(../guides/own_parts.md#rewards)."
}
"""Arguments that another page describes."""


def _others(values: tuple[str, ...]) -> str:
    return ", ".join(f"`{value!r}`" for value in values[1:]).replace("'", '"')


OPTIONS = {
    ("start", "min_start_distance"): ("starts", '`"marks"`; a number of moves'),
    ("move_order",): ("a-step", _others(MOVE_ORDERS)),
    ("capture", "n_catch"): ("captures", f"{_others(CAPTURES)}; a number of chasers"),
    ("capture_check",): ("a-step", _others(CAPTURE_CHECKS)),
    ("exits", "num_exits"): ("exits", "cells, by default the marks `E`; a number that is drawn"),
    ("collisions",): ("collisions", _others(COLLISIONS)),
    ("slip",): ("slips", "a probability, of all agents or by role or agent"),
}
"""The options of the rules, with their section of the page of rules and their other values."""
OF_RULES = [name for names in OPTIONS for name in names]


def options(_: str) -> str:
    """The options of the rules, with their defaults."""
    common = settings_of(pursuit.make_task("chase"))
    body = [
        (
            f"[{', '.join(f'`{name}`' for name in names)}](#{section})",
            ", ".join(f"`{plain(common[name])}`" for name in names),
            others,
        )
        for names, (section, others) in OPTIONS.items()
    ]
    return rows(("option", "default", "other values"), body)


def given_by(name: str) -> dict[str, Any]:
    """The arguments of `parallel_env`, with their defaults."""
    task = pursuit.ReacherTask() if name == "reacher" else pursuit.make_task(name)
    return {**own_parameters(module_of(name).parallel_env), **settings_of(task)}


def arguments(name: str) -> str:
    """Of `parallel_env`."""
    if name == "reacher":
        return argument_rows(given_by(name), described(ReacherParallelEnv, pursuit.ReacherTask), ())
    return argument_rows(given_by(name), described(PursuitParallelEnv, pursuit.Task), OF_RULES)


def gymnasium_arguments(name: str) -> str:
    """Those that Gymnasium's environments have besides those of `parallel_env`."""
    made = (
        environments.make_env,
        environments.single_agent_arguments,
        environments.make_vector_env,
    )
    common = given_by(name)
    own = {key: value for key, value in own_parameters(*made).items() if key not in common}
    return argument_rows(own, described(*made, SingleAgentVectorEnv), ())


# -- spaces and rewards ----------------------------------------------------------------------------


def facts(name: str) -> str:
    """Ids, agents and spaces, of the environment as it is by default; of tasks in mazes, whose
    actions and state are on the page of environments, rewards, end and reference."""
    env = module_of(name).parallel_env()
    ids = [f"`pursuit/{i}-v0`" for i in GYMNASIUM[name]]
    agent = env.possible_agents[0]
    more = [
        ("Actions", f"`{space(env.action_space(agent))}`"),
        ("State", f"`{space(env.state_space)}`"),
    ]
    if name in ENDS:
        terminated, compared, reference = ENDS[name]
        end = f"truncated after {env.task.max_steps} steps"
        more = [
            ("Rewards", paid_by_default(env.task)),
            ("Ends", f"terminated when {terminated}, {end}"),
            ("Compared by", compared),
            ("Reference", reference),
            *([("Defaults", differing)] if (differing := differences(env.task)) else []),
        ]
    return rows(
        ("", "by default"),
        [
            ("PettingZoo", f"`from pursuit import {name}_v0`; id `pursuit/{name}-v0`"),
            ("Gymnasium", ", ".join(ids)),
            ("Agents", ", ".join(f"`{agent}`" for agent in env.possible_agents)),
            (
                "Observation",
                f'`observation="{env.observation}"`: `{space(env.observation_space(agent))}`',
            ),
            *more,
        ],
    )


_SMALL = "in small games (such as 5x5 with 3 goals)"
_ELSE = "in larger ones that of the best scripted agent"
ENDS = {
    "chase": (
        "no evader is left",
        "mean steps; for chasers fewer is better, for evaders more",
        "duels exact: the best response to any policy that depends on the two cells, and the value "
        "of the game; teams exact while they fit ([limits](../reference/exact_limits.md))",
    ),
    "maze": (
        "no goal is left",
        "mean steps",
        f"exact up to {limits_module.MAX_EXACT_GOALS} goals: the shortest tour "
        "(Held and Karp, 1962)",
    ),
    "race": (
        "no goal is left, for all",
        "mean number of goals",
        f"{_SMALL} exact: the largest number of goals against these rivals, {_ELSE}",
    ),
    "heist": (
        "no evader or no goal is left",
        "mean return",
        f"{_SMALL} exact: the highest return, {_ELSE}",
    ),
    "escape": (
        "no evader is left",
        "captures minus escapes",
        "in small games [exact](../explanation/exact.md#the-escape-value): P(capture) - P(escape) "
        "of given policies, of best responses, and in NashConv",
    ),
}
"""When a task in a maze terminates, by what agents are compared, and with what."""


def paid_by_default(task: pursuit.Task) -> str:
    """The rewards of a task: their name, or coefficients by role."""
    given: Any = task.rewards
    if isinstance(given, str):
        return f"`{plain(given)}`"
    own = "; ".join(f"{role}: {coefficients(paid)}" for role, paid in given.items())
    return f"{own}; other roles as `{plain(pursuit.Task.rewards)}`"


def differences(task: pursuit.Task) -> str:
    """The settings of a task whose defaults are not those of chase."""
    common, given = settings_of(pursuit.make_task("chase")), settings_of(task)
    return ", ".join(
        f"`{n}={plain(v)}`" for n, v in given.items() if n != "rewards" and v != common[n]
    )


def space(given: gymnasium.Space[Any]) -> str:
    """A space in a few words: bounds that differ by entry are a range."""
    if isinstance(given, gymnasium.spaces.Box):
        low, high = given.low.min(), given.high.max()
        return f"Box({low:g}, {high:g}, {tuple(map(int, given.shape))}, {given.dtype})"
    return str(given)


def observations(_: str) -> str:
    """Every encoding and what it is."""
    texts = dict(_bullets(Encoder.__doc__ or ""))
    return rows(("encoding", "what it is"), [(f'`"{each}"`', texts[each]) for each in ENCODINGS])


def _bullets(text: str) -> Iterator[tuple[str, str]]:
    for bullet in re.findall(r"- (\".*?)(?=\n\s*- \"|\n\n)", text, re.DOTALL):
        name, _, said = bullet.partition(":")
        yield name.strip('"'), " ".join(said.split())


def rewards(_: str) -> str:
    """The coefficients of every scheme by role, without those that are 0."""
    return rows(
        ("`rewards`", *ROLES),
        [
            (f"`{scheme}`", *(coefficients(by_role[role]) for role in ROLES))
            for scheme, by_role in REWARD_SCHEMES.items()
        ],
    )


def coefficients(paid: Rewards) -> str:
    """Those that are not 0, and when they are paid."""
    flags = [f"`{f.name}`" for f in fields(paid) if getattr(paid, f.name) is True]
    given = [
        f"{f.name} {value:g}"
        for f in fields(paid)
        if (value := getattr(paid, f.name)) and value is not True
    ]
    return ", ".join([*given, *flags])


# -- names -----------------------------------------------------------------------------------------


def names(package: str) -> str:
    """The names of a page of the API, each with the first sentence of its docstring."""
    text = (DOCS / "api" / f"{package}.md").read_text(encoding="utf-8")
    body = []
    for name in re.findall(r"^::: (\S+)$", text, re.MULTILINE):
        module, _, last = name.rpartition(".")
        found = getattr(import_module(module), last)
        said = repr(found) if isinstance(found, tuple) else getdoc(found) or ""
        sentence = re.split(r"(?<=[.:])\s+(?=[A-Z(\[`{]|$)|\n\n", said)[0]
        assert sentence, f"{name}: no docstring"
        body.append((f"`{name}`", re.sub(r":$", ".", " ".join(sentence.split()))))
    return rows(("name", "what"), body)


# -- exact solutions -------------------------------------------------------------------------------

SOLVERS = {
    "tour": "`shortest_tour`",
    "duel": "`best_response`, `evaluate_exactly`",
    "team": "`best_team_response`, `evaluate_team`",
    "joint": "`solve_joint`, `evaluate_joint`",
    "bounds": "`solve_hidden_chase`",
    "small_game": "`respond`, `nash_conv`, `equilibrium`",
    "arm": "`least_steps`",
}
"""By kind of solver, its functions for users."""

SIZES = (
    (("chase", "5x5", 2, 1, 0), "a second"),
    (("chase", "7x7", 2, 1, 0), "seconds"),
    (("race", "5x5", 0, 0, 3), "15 seconds"),
    (("chase", "5x5", 3, 1, 0), "half a minute"),
    (("chase", "4x4", 4, 1, 0), "two minutes"),
)
"""Games (task, maze, chasers, evaders, goals), and about how long their solution takes."""

LIMITS = (
    ("joint solvers", "MAX_STATES states", "play episodes"),
    (
        "`solve_joint_game`",
        "MAX_GAME_STATES states (minutes), discount MAX_DISCOUNT",
        "a smaller game or discount",
    ),
    ("`enumerate_game`", "MAX_SMALL_STATES states, or entries of a list", "`most_states`"),
    ("`game_of_task`, `game_of_sides`", "MAX_TASK_STATES states", "joint solvers"),
    ("`expected_tour_length`", "MAX_ENUMERATED_PLACEMENTS placements", "it samples"),
    ("`least_steps`", "MAX_ARM_NODES nodes (0.2 seconds)", "a lower bound"),
    ("`alpha_rank`", "MAX_PROFILES rows × columns", "fewer strategies"),
    ("duels", "MAX_DUEL_ENTRIES cells × rows × columns", "remove blocked rows and columns"),
    (
        "self-play: NashConv of a team against one evader",
        "work MAX_EXACT_WORK; at the end, and payoffs in leagues, MAX_FINAL_WORK",
        "a trained response, a lower bound",
    ),
    ("self-play: value of a duel", "MAX_GAME_CELLS cells (minutes)", "NashConv alone"),
    ("self-play: mixtures, diversity of snapshots", "MAX_SNAPSHOT_CELLS cells", "left out"),
    (
        "runs: interval under a limited view",
        "SEARCH_SECONDS seconds, or upper / lower - 1 = SEARCH_WIDTH",
        "the interval so far",
    ),
    (
        "runs: [objective gap](../explanation/objectives.md)",
        "duels MAX_OBJECTIVE_CELLS cells; one runner MAX_TOUR_WORK (goal set, next goal, cell), "
        "MAX_TOUR_BYTES; others work MAX_OBJECTIVE_WORK (15 seconds)",
        "left out",
    ),
    ("curricula: least steps of the arm", "MAX_CURRICULUM_JOINTS joints", "unknown"),
    (
        "memory",
        "`solve_chase` MAX_CHASE_BYTES (team agents `equilibrium` MAX_TEAM_BYTES), "
        "`solve_in_turns` MAX_TURN_BYTES, joint values MAX_STATE_BYTES, transitions "
        "MAX_STORE_BYTES",
        "a smaller game",
    ),
    ("a plan for every step", "MAX_PLAN_BYTES", "the first step's plan in all"),
)
"""Further limits: of what, how much, and what happens or is to be done above."""


def with_numbers(text: str) -> str:
    """A text in which the names of limits are replaced by their values."""

    def value(name: re.Match[str]) -> str:
        number = getattr(limits_module, name[0])
        return f"{number / 1e9:g} GB" if name[0].endswith("_BYTES") else f"{number:,}"

    return re.sub(LIMIT, value, text)


LIMIT = r"\b(?:MAX|SEARCH|SOLVED)_[A-Z_]+\b"


def sentences(function: Callable[..., Any]) -> list[str]:
    """Those of a docstring."""
    return " ".join((getdoc(function) or "").split()).removesuffix(".").split(". ")


def solvers(_: str) -> str:
    """What is solved, by pairs of sentences of docstrings, and the functions."""
    body = []
    for solver in (*MAZES, *SMALL_GAMES, *ARMS):
        said = sentences(solver.why_not)
        for game, compared in zip(said[::2], said[1::2], strict=True):
            body.append((game, SOLVERS[solver.kind], compared))
    bound = "A bound, where one is known: the optimum with full view, or with continuous actions"
    body.append(("Everything else", "–", f"{bound}; otherwise the best scripted agent"))
    return with_numbers(rows(("game and size", "solvers", "results are compared with"), body))


def sizes(_: str) -> str:
    """The work of some games."""
    body = []
    for (task, maze, chasers, evaders, goals), seconds in SIZES:
        team = {"num_chasers": chasers, "num_evaders": evaders} if evaders else {"num_goals": goals}
        work = limits_module.work_of(pursuit.make_task(task, maze=maze, **team))
        who = f"{chasers} against {evaders}" if evaders else f"2 runners, {goals} goals"
        body.append((f"{task} {maze}, {who}", f"{work:,}", seconds))
    return rows(("game", "work", "solved in"), body)


def limits(_: str) -> str:
    """Every other constant of `exact/limits.py`."""
    tree = ast.parse(Path(limits_module.__file__).read_text(encoding="utf-8"))
    assigned = [line.targets[0] for line in tree.body if isinstance(line, ast.Assign)]
    names = {part.id for each in assigned for part in ast.walk(each) if isinstance(part, ast.Name)}
    texts = [getdoc(solver.why_not) or "" for solver in MAZES]
    texts += [cell for row in LIMITS for cell in row]
    silent = names - {"REMEDY", *re.findall(LIMIT, " ".join(texts))}
    assert not silent, f"the page of limits does not name {silent}; add them to LIMITS"
    return with_numbers(rows(("of", "up to", "above it"), [*LIMITS]))


TABLES: dict[str, Callable[[str], str]] = {
    "facts": facts,
    "arguments": arguments,
    "gymnasium": gymnasium_arguments,
    "observations": observations,
    "rewards": rewards,
    "options": options,
    "names": names,
    "solvers": solvers,
    "sizes": sizes,
    "limits": limits,
}


if __name__ == "__main__":
    for page in pages():
        path = ROOT / page
        path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")
