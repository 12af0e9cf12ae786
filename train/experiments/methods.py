"""The methods paragraph of runs: what was done with what, every fact from `config.json` and
`results.json`, so that a paper says what ran and not what somebody remembers of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripted_agents.environments import AGENTS
from train.experiments.defaults import defaults_of
from train.experiments.forms import read_label
from train.experiments.sweep import MEASURED, flat_plain
from train.experiments.where_and_how import commands_told, parts_told, where_it_ran
from train.files import read_json
from train.result_table import Column, ResultTable, Row, in_markdown, words
from train.runs.folder import CONFIG, RESULTS, RUN, SELF_PLAY, SIDE, load_results, read_config
from train.runs.provenance import COMMAND, Records, recorded_parts
from train.runs.saved import ADDED_HYPER
from train.settings.self_play import LEARN, ROLES
from train.settings.task import who_learns

METHODS = "methods.md"
METHODS_LINE = f"How these runs were made: [{METHODS}]({METHODS})."
TOLD = (
    *("task", "role", "maze", "algorithm", "evaluate", "seed", "variant", "kind"),
    *MEASURED.values(),
)
"""Settings that stand in the paragraph, and so in no table."""
NONE, MISSING = "none", "–"
"""What stands for no value, and for a setting that a run has not."""


@dataclass(frozen=True)
class Facts:
    """What the files of a run say.

    Attributes:
        name: of its folder.
        kind: of run.
        settings: by name, without levels; mazes by their names.
        defaults: the same, as they would be if nobody had set them.
        results: `results.json`, checked; empty where there is none yet.
        command: that began it.
        parts: of users' own, with the hashes of their source.
    """

    name: str
    kind: str
    settings: Row
    defaults: Row
    results: dict[str, Any]
    command: str
    parts: Records


def facts_of(folder: Path) -> Facts:
    """The facts of a run of whatever kind.

    Raises:
        ValueError: no run there, or a damaged one.
    """
    kind, plain = read_config(folder)
    results = load_results(folder) if (folder / RESULTS).exists() else {}
    label = read_label(folder)
    settings, defaults = flat_plain(plain), flat_plain(defaults_of(kind, plain))
    settings = {name: one for name, one in ADDED_HYPER.items() if name in defaults} | settings
    if "maze" in settings:
        settings["maze"] = results.get("maze") or label.get("maze") or _named(settings["maze"])
    if settings.get("curriculum_mazes"):
        given = label.get("curriculum_mazes", settings["curriculum_mazes"])
        settings["curriculum_mazes"] = _named(given)
    settings |= {n: label[n] for n in ("opponent", "chaser", "evader", "variant") if n in label}
    if kind == RUN and "role" in settings:
        settings["role"] = who_learns(settings["task"], settings["role"])
    command = read_json(folder / CONFIG).get(COMMAND, "")
    parts = recorded_parts(folder / CONFIG)
    return Facts(folder.name, kind, settings, defaults, results, str(command), parts)


def _named(maze: Any) -> str:
    """A maze by its name; one that is known by its text alone is said to be."""
    return "given as text in config.json" if "\n" in str(maze) else str(maze)


def methods(folders: Sequence[Path | str]) -> str:
    """What was done, as Markdown, ready for a paper's section on methods.

    Args:
        folders: of the runs, at least one.

    Raises:
        ValueError: a folder that holds no run, or a damaged one.
    """
    lines = ["# Methods", ""]
    facts = [facts_of(Path(folder)) for folder in folders]
    for form in dict.fromkeys(map(_form_of, facts)):
        lines += _of_one_kind([run for run in facts if _form_of(run) == form])
    return "\n".join([*lines, *commands_told(run.command for run in facts)])


def _form_of(run: Facts) -> tuple[str, bool]:
    """What runs must share to be told of together: their kind, and whether an arm learns."""
    return run.kind, "joints" in run.settings


def _of_one_kind(runs: Sequence[Facts]) -> list[str]:
    """The paragraph of runs of one kind, and the tables that it needs."""
    varying = _varying(runs)
    lines = [in_markdown(" ".join(_sentences(runs))), ""]
    shared = [
        name
        for name in _names(runs)
        if name not in (*varying, *TOLD) and all(name in run.settings for run in runs)
    ]
    rows = [
        {"setting": name, "value": _text(runs[0].settings[name]), "default": told}
        for name in shared
        if (told := _default(runs, name)) != _text(runs[0].settings[name])
    ]
    unknown = [row for row in rows if row["default"] == MISSING]
    rows = [row for row in rows if row["default"] != MISSING]
    if rows:
        lines += [f"Settings of {_all(runs)} that differ from the defaults:", ""]
        lines += [_settings_table(rows).markdown(), ""]
    else:
        lines += [f"Otherwise the settings of {_all(runs)} are the defaults.", ""]
    if unknown:
        table = ResultTable(unknown, [words("setting"), words("value")])
        lines += [f"Settings of user-defined parts in {_all(runs)}:", "", table.markdown(), ""]
    if varying:
        lines += ["What they differ in:", "", _differences(runs, varying).markdown(), ""]
    return lines + parts_told(run.parts for run in runs)


def league_methods(content: Mapping[str, Any], folders: Sequence[Path]) -> str:
    """What was done in a league, and how the runs in it were made.

    Args:
        content: of `league.json`.
        folders: of its runs; one role of self-play counts as the run that it was trained in.

    Raises:
        ValueError: a folder that holds no run, or a damaged one.
    """
    how = "most probable" if content["greedy"] else "drawn"
    exact = not any(half for row in content["ci95"] for half in row)
    told = (
        f"{len(content['chasers'])} chasers met {len(content['evaders'])} evaders in the task "
        f"{content['task']} on maze {content['maze']}, at most {content['max_steps']} steps a "
        f"game; learned policies take {how} actions, and A* makes "
        f"{100 * content['opponent_epsilon']:g} % random moves. "
        f"Payoffs are mean steps until capture, "
        + ("exact over all starts" if exact else "exact over all starts where ± is missing, else ")
        + ("" if exact else f"of {content['games']} games with their 95 % intervals")
        + f". Ratings are of {content['games']} games of each pair, from starts that are the same "
        f"for all and that nothing was trained with (seed {content['seed']}): Elo by maximum "
        "likelihood (Bradley and Terry) with bootstrap intervals, openskill's Plackett-Luce model, "
        "and Nash averaging (Balduzzi et al., 2018). " + where_it_ran([content])
    )
    runs = dict.fromkeys(_run_of(folder) for folder in folders)
    text = "\n".join(
        ["# Methods", "", in_markdown(told), "", *commands_told([str(content["command"])])]
    )
    return text if not runs else text + "\n" + methods(list(runs)).replace("# Methods", "## Runs")


def _run_of(folder: Path) -> Path:
    """The run that a folder belongs to: its own, or of one role of self-play the one above."""
    return folder.parent if read_config(folder)[0] == SIDE else folder


def _names(runs: Sequence[Facts]) -> list[str]:
    return list(dict.fromkeys(name for run in runs for name in run.settings))


def _varying(runs: Sequence[Facts]) -> list[str]:
    """The settings that are not alike in all runs, seeds apart.

    One that only some of them have (a clip of PPO's beside A2C) counts where it is not the default.
    """
    found = []
    for name in _names(runs):
        have = [run for run in runs if name in run.settings]
        values = {_text(run.settings[name]) for run in have}
        usual = all(_text(run.settings[name]) == _default([run], name) for run in have)
        differs = len(values) > 1 or (len(have) < len(runs) and not usual)
        if differs and name not in ("seed", "variant"):
            found.append(name)
    return found


def _default(runs: Sequence[Facts], name: str) -> str:
    """What a setting is by default; all that it is, where that depends on the run.

    `MISSING` for a setting of a user's own part, whose defaults are not known here.
    """
    return " or ".join(dict.fromkeys(_text(run.defaults.get(name, MISSING)) for run in runs))


def _text(value: Any) -> str:
    if value is None:
        return NONE
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return " ".join(map(str, value)) or NONE
    return str(value)


def _settings_table(rows: list[Row]) -> ResultTable:
    return ResultTable(rows, [words("setting"), words("value"), words("default")])


def _differences(runs: Sequence[Facts], varying: Sequence[str]) -> ResultTable:
    """A row for everything that was done with several seeds."""
    rows: dict[str, Row] = {}
    named = any(run.settings.get("variant") for run in runs)
    for run in runs:
        row: Row = {"name": run.settings.get("variant") or ""} if named else {}
        row |= {name: _text(run.settings.get(name, MISSING)) for name in varying}
        seeds = rows.setdefault(str(row), row | {"seeds": []})["seeds"]
        seeds.append(run.settings["seed"])
    heads = [*(["name"] if named else []), *varying]
    columns = [words(name) for name in heads]
    columns.append(Column("seeds", lambda row: ", ".join(map(str, sorted(row["seeds"])))))
    return ResultTable(list(rows.values()), columns)


def _sentences(runs: Sequence[Facts]) -> list[str]:
    """The paragraph."""

    def each(value: Callable[[Facts], Any]) -> str:
        return " or ".join(dict.fromkeys(_text(value(run)) for run in runs))

    def setting(name: str) -> str:
        return each(lambda run: run.settings.get(name))

    pairs = runs[0].kind == SELF_PLAY
    said = [_who(runs, setting)]
    place = f"on maze {setting('maze')}" if "maze" in runs[0].settings else ""
    joints = f"with {setting('joints')} joints" if "joints" in runs[0].settings else ""
    where = " ".join(part for part in (f"the task {setting('task')}", place, joints) if part)
    subject = "It plays" if len(runs) == 1 and not pairs else "They play"
    said.append(f"{subject} {where}, at most {setting('max_steps')} steps an episode.")
    if pairs:
        said += dict.fromkeys(map(_opponents, runs))
    elif "opponent_epsilon" in runs[0].settings and setting("task") != "maze":
        seats = each(_opponent)
        if setting("task") == "race" and setting("opponent") in (NONE, "astar"):
            seats = seats.replace("A*", "nearest-goal runners")
        said.append(f"All other seats are played by {seats}.")
    said.append(f"{_budget(runs)}; {_seeds(runs)}.")
    done = [run for run in runs if run.results]
    if done:
        said += _measured(done)
    return said


def _who(runs: Sequence[Facts], setting: Callable[[str], str]) -> str:
    number = len(runs)
    if runs[0].kind == SELF_PLAY:
        learn = [role for role in ROLES if any(run.settings[role] == LEARN for run in runs)]
        sides = [f"{role}s by {_learners(setting(f'{role}_algorithm'))}" for role in learn]
        one, several = ("pair of sides", "pairs of sides") if len(learn) == 2 else ("side", "sides")
        what = f"A {one} was" if number == 1 else f"{number} {several} were"
        return f"{what} trained in self-play: {', '.join(sides)}."
    role = setting("role") if "role" in runs[0].settings else "arm"
    what = f"One agent ({role}) was" if number == 1 else f"{number} agents ({role}) were"
    curriculum = setting("curriculum")
    taught = "without a curriculum" if curriculum == NONE else f"with the curriculum {curriculum}"
    return f"{what} trained by {_learners(setting('algorithm'))}, {taught}."


def _learners(names: str) -> str:
    return " or ".join(map(_learner, names.split(" or ")))


def _learner(name: str) -> str:
    """A learner as papers write it."""
    return name.replace("_", " ") if "_" in name or ":" in name else name.upper()


def _opponents(run: Facts) -> str:
    """Against what the sides of self-play learn; a side that does not is said to be played."""
    fixed = [role for role in ROLES if run.settings[role] != LEARN]
    if not fixed and run.settings["sampling"] == "latest":
        return "Both sides learn against each other's latest policies."
    if not fixed:
        return (
            "Both sides learn against snapshots of each other, drawn by the scheme "
            f"{run.settings['sampling']}."
        )
    name = str(run.settings[fixed[0]])
    if name == "astar":
        name = f"A* with {100 * run.settings['opponent_epsilon']:g} % random moves"
    return f"The {fixed[0]}s do not learn; they are played by {name}."


def _opponent(run: Facts) -> str:
    """Who plays the seats in which nobody learns."""
    chance = f"{100 * run.settings['opponent_epsilon']:g} % random moves"
    name = run.settings["opponent"]
    if name in (None, "astar"):
        return f"A* with {chance}"
    if name in AGENTS:
        return str(name) if name == "random" else f"{name} with {chance}"
    how = run.settings["opponent_policy"]
    return f"{name} (its {how} policy where it was learned; A* with {chance} beside it)"


def _budget(runs: Sequence[Facts]) -> str:
    told = []
    for name, unit in (("budget_seconds", "s"), ("budget_frames", "frames")):
        values = dict.fromkeys(run.settings[name] for run in runs)
        given = [value for value in values if value is not None]
        told += [f"{value:,}".removesuffix(".0") + f" {unit}" for value in given]
    text = f"The budget of a run is {' or '.join(told)} of training"
    timed = [run for run in runs if run.settings["budget_seconds"] is not None]
    own = [run for run in timed if run.settings.get("clock") == "processor"]
    if own:
        some = "" if len(own) == len(timed) else f" (of {len(own)} of {len(timed)} runs)"
        text += f", in seconds{some} that the run computed, whatever else the machine did"
    done = [run.results for run in runs if run.results]
    if done:
        text += f"; it took {_span([r['frames'] for r in done], 'frames', ',')} and "
        text += _span([round(r["seconds"], 1) for r in done], "s")
    return text


def _span(values: Sequence[float], unit: str, form: str = "g") -> str:
    low, high = min(values), max(values)
    if low == high:
        return f"{low:{form}} {unit}"
    return f"{low:{form}} to {high:{form}} {unit}"


def _seeds(runs: Sequence[Facts]) -> str:
    seeds = sorted({run.settings["seed"] for run in runs})
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"


def _measured(done: Sequence[Facts]) -> list[str]:
    """How it was evaluated, by what, and where it ran."""
    said = []
    if done[0].kind == RUN:
        kinds = " or ".join(sorted({str(run.settings["evaluate"]) for run in done}))
        exact = {bool(run.results["evaluation"]["exact"]) for run in done}
        played = {run.results["evaluation"]["episodes"] for run in done}
        how = "exactly, over all starts" if exact == {True} else (
            f"on {_span(sorted(played), 'episodes', ',')} whose starts nothing was trained with"
        )  # fmt: skip
        if len(exact) == 2:
            how += " where no exact evaluation is known"
        said.append(f"The {kinds} policy is evaluated {how}.")
        known = [run.results["evaluation"]["optimal_steps"] is not None for run in done]
        if all(known):
            bound = {run.results.get("least", {}).get("share_exact", 1.0) == 1.0 for run in done}
            optimum = "the exact optimum" if bound == {True} else "a lower bound of the optimum"
            said.append(f"Its gap is to {optimum} of the same task and starts.")
    columns = {(run.results["objective"]["column"], run.results["objective"]["unit"])
               for run in done}  # fmt: skip
    judged = " or ".join(
        name if name.replace("_", " ").endswith(unit) else f"{name} ({unit})"
        for name, unit in sorted(columns)
    )
    said.append(f"Runs are judged by {judged.replace('_', ' ')}.")
    cut = [run.name for run in done if run.results["interrupted"]]
    if cut:
        said.append(f"Interrupted before their budget was spent: {', '.join(cut)}.")
    said.append(where_it_ran([run.results for run in done]))
    return said


def _all(runs: Sequence[Facts]) -> str:
    return "the run" if len(runs) == 1 else f"all {len(runs)} runs"
