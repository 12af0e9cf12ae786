"""How runs were made, as tables: every fact from `config.json` and `results.json`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train.experiments.defaults import defaults_of
from train.experiments.forms import read_label
from train.experiments.sweep import flat_plain
from train.files import read_json
from train.reports.tables import Column, ResultTable, Row, one_line, plain_table, words
from train.runs.folder import CONFIG, RESULTS, RUN, SIDE, load_results, read_config
from train.runs.provenance import COMMAND, Records, recorded_parts
from train.settings.task import who_learns

METHODS = "methods.md"
METHODS_LINE = f"How these runs were made: [{METHODS}]({METHODS})."
ALWAYS = (
    *("task", "maze", "role", "joints", "algorithm", "chaser_algorithm", "evader_algorithm"),
    *("chaser", "evader", "sampling", "curriculum", "opponent", "opponent_epsilon", "max_steps"),
    *("evaluate", "budget_frames", "budget_seconds", "frames", "seconds", "clock"),
)
"""Settings that are told also where they are the defaults."""
OF_OPPONENTS = ("opponent", "opponent_epsilon")
NONE, MISSING = "none", "–"
"""What stands for no value, and for a setting that a run has not."""


@dataclass(frozen=True)
class Facts:
    """What the files of a run say.

    Attributes:
        name: of its folder.
        kind: of run.
        settings: by name, without levels, as texts; mazes by their names.
        defaults: the same, as they would be if nobody had set them.
        seed: of the run.
        results: `results.json`, checked; empty where there is none yet.
        command: that began it.
        parts: of users' own, with the hashes of their source.
    """

    name: str
    kind: str
    settings: dict[str, str]
    defaults: dict[str, str]
    seed: int
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
    if "maze" in settings:
        settings["maze"] = results.get("maze") or label.get("maze") or settings["maze"]
    names = ("curriculum_mazes", "opponent", "chaser", "evader", "variant")
    settings |= {name: label[name] for name in names if name in label}
    if kind == RUN and "role" in settings:
        settings["role"] = who_learns(settings["task"], settings["role"])
    seed = settings.pop("seed")
    for name in OF_OPPONENTS if settings["task"] in ("maze", "reacher") else ():
        settings.pop(name, None)
    command = read_json(folder / CONFIG).get(COMMAND, "")
    return Facts(
        folder.name,
        kind,
        {name: _text(value) for name, value in settings.items()},
        {name: _text(value) for name, value in defaults.items()},
        seed,
        results,
        str(command),
        recorded_parts(folder / CONFIG),
    )


def _text(value: Any) -> str:
    if value is None:
        return NONE
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return " ".join(map(_text, value)) or NONE
    # a maze that is known by its text alone
    return "given as text in config.json" if "\n" in str(value) else str(value)


def methods(folders: Sequence[Path | str]) -> str:
    """How runs were made, as Markdown: settings and results beside the defaults, what runs differ
    in, users' own parts, and commands.

    Args:
        folders: of the runs, at least one.

    Raises:
        ValueError: a folder that holds no run, or a damaged one.
    """
    lines = ["# Methods", ""]
    facts = [facts_of(Path(folder)) for folder in folders]
    for kind in dict.fromkeys(run.kind for run in facts):
        runs = [run for run in facts if run.kind == kind]
        lines += [settings_table(runs).markdown(), ""]
        if varying := _varying(runs):
            lines += ["What they differ in:", "", _differences(runs, varying).markdown(), ""]
        lines += parts_told(run.parts for run in runs)
    return "\n".join([*lines, *commands_told(run.command for run in facts)])


def settings_table(runs: Sequence[Facts]) -> ResultTable:
    """The settings that are not the defaults, or always told, and what the runs came to."""

    def each(of: str, name: str) -> str:
        return " or ".join(dict.fromkeys(getattr(run, of).get(name, MISSING) for run in runs))

    rows: list[Row] = [{"setting": "runs", "value": f"{len(runs)} ({runs[0].kind})"}]
    for name in dict.fromkeys([*ALWAYS, *(name for run in runs for name in run.settings)]):
        value, default = each("settings", name), each("defaults", name)
        if value != MISSING and name != "variant" and (name in ALWAYS or value != default):
            default = "" if name.startswith("budget") else default
            rows.append({"setting": name, "value": value, "default": default})
    rows.append({"setting": "seeds", "value": ", ".join(map(str, sorted({r.seed for r in runs})))})
    done = [run for run in runs if run.results]
    rows += [{"setting": name, "value": value} for name, value in _measured(done).items() if done]
    rows = [{"default": ""} | row for row in rows]
    return ResultTable(rows, [words("setting"), words("value"), words("default")])


def _measured(done: Sequence[Facts]) -> dict[str, str]:
    """How long runs learned, how they were evaluated, by what, and where they ran."""
    results = [run.results for run in done]
    found = {
        "frames trained": _span([each["frames"] for each in results], ","),
        "seconds trained": _span([round(each["seconds"], 1) for each in results]),
    }
    if done and done[0].kind == RUN:
        scores = [each["evaluation"] for each in results]
        starts = _span([score["episodes"] for score in scores], ",")
        found["evaluation"] = _each(
            "exact, over all starts" if score["exact"] else f"{starts} episodes, held-out seeds"
            for score in scores
        )
        found["reference"] = _each(
            "none exact" if each["evaluation"]["optimal_steps"] is None
            else "exact optimum" if each.get("least", {}).get("share_exact", 1.0) == 1.0
            else "lower bound of the optimum"
            for each in results
        )  # fmt: skip
    found["judged by"] = _each(
        f"{each['objective']['column'].replace('_', ' ')} ({each['objective']['unit']})"
        for each in results
    )
    cut = [run.name for run in done if run.results["interrupted"]]
    found |= {"interrupted before the budget was spent": ", ".join(cut)} if cut else {}
    return found | where_they_ran(results)


def _each(texts: Iterable[str]) -> str:
    return " or ".join(dict.fromkeys(texts))


def _span(values: Sequence[float], form: str = "g") -> str:
    low, high = min(values, default=0), max(values, default=0)
    return f"{low:{form}}" if low == high else f"{low:{form}} to {high:{form}}"


def _varying(runs: Sequence[Facts]) -> list[str]:
    """The settings that are not alike in all runs.

    One that only some of them have (a clip of PPO's beside A2C) counts where it is not the default.
    """
    found = []
    for name in dict.fromkeys(name for run in runs for name in run.settings):
        have = [run for run in runs if name in run.settings]
        usual = all(run.settings[name] == run.defaults.get(name, MISSING) for run in have)
        differs = len({run.settings[name] for run in have}) > 1
        if name != "variant" and (differs or (len(have) < len(runs) and not usual)):
            found.append(name)
    return found


def _differences(runs: Sequence[Facts], varying: Sequence[str]) -> ResultTable:
    """A row for everything that was done with several seeds."""
    rows: dict[str, Row] = {}
    heads = [*(["variant"] if any("variant" in run.settings for run in runs) else []), *varying]
    for run in runs:
        row = {name: run.settings.get(name, MISSING) for name in heads}
        rows.setdefault(str(row), row | {"seeds": []})["seeds"].append(run.seed)
    seeds = Column("seeds", lambda row: ", ".join(map(str, sorted(row["seeds"]))), left=True)
    return ResultTable(list(rows.values()), [*map(words, heads), seeds])


def league_methods(content: Mapping[str, Any], folders: Sequence[Path]) -> str:
    """What was done in a league, and how the runs in it were made.

    Args:
        content: of `league.json`.
        folders: of its runs; one role of self-play counts as the run that it was trained in.

    Raises:
        ValueError: a folder that holds no run, or a damaged one.
    """
    sampled = any(half for row in content["ci95"] for half in row)
    found = {
        "task": content["task"],
        "maze": content["maze"],
        "most steps of a game": content["max_steps"],
        "chasers": len(content["chasers"]),
        "evaders": len(content["evaders"]),
        "actions of learned policies": "most probable" if content["greedy"] else "drawn",
        "random moves of A*": f"{100 * content['opponent_epsilon']:g} %",
        "payoffs": "mean steps until capture, exact over all starts"
        + (f"; where ± stands, of {content['games']} games (95 % intervals)" if sampled else ""),
        "ratings": f"of {content['games']} games a pair, the same held-out starts for all (seed "
        f"{content['seed']}): Elo by maximum likelihood (Bradley and Terry) with bootstrap "
        "intervals, Nash averaging (Balduzzi et al., 2018)",
    } | where_they_ran([content])
    rows = [{"setting": name, "value": value} for name, value in found.items()]
    lines = ["# Methods", "", plain_table(rows).markdown(), ""]
    lines += commands_told([str(content["command"])])
    # One role of self-play belongs to the run in the folder above.
    runs = dict.fromkeys(
        folder.parent if read_config(folder)[0] == SIDE else folder for folder in folders
    )
    if runs:
        lines.append(methods(list(runs)).replace("# Methods", "## Runs"))
    return "\n".join(lines)


# -- where and by what command ---------------------------------------------------------------------


def where_they_ran(results: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The versions and the machines in results."""
    return {
        "software": _each(_versions(each["versions"]) for each in results),
        "machine": _each(map(_machine, results)),
    }


def _versions(found: Mapping[str, Any]) -> str:
    parts = [f"{name} {value}" for name, value in found.items() if value and name != "commit"]
    if found.get("commit"):
        commit = str(found["commit"])
        parts[0] += f" (commit {commit[:12]}{', changed since' if commit[-1] == '+' else ''})"
    return ", ".join(parts)


def _machine(results: Mapping[str, Any]) -> str:
    found, processes = results["machine"], results.get("processes", 1)
    parts = [str(found["processor"])]
    if "cores" in found:
        parts.append(f"{found['cores']} cores")
    if "threads" in found:
        each = f" in each of {processes} processes" if processes > 1 else ""
        parts.append(f"torch with {found['threads']} thread(s){each}")
    return ", ".join(parts)


def parts_told(given: Iterable[Records]) -> list[str]:
    """User-defined parts with the hashes of their source as lines of Markdown, each once."""
    heads = ("setting", "name", "SHA-256 of the source")
    found = dict.fromkeys(
        (setting, str(part["name"]), part["sha256"] or "no source")
        for records in given
        for setting, part in records.items()
    )
    rows = [dict(zip(heads, row, strict=True)) for row in found]
    return ["User-defined parts:", "", plain_table(rows).markdown(), ""] if rows else []


def commands_told(given: Iterable[str]) -> list[str]:
    """Commands as lines of Markdown, each once."""
    commands = list(dict.fromkeys(one_line(_as_typed(command)) for command in given if command))
    if not commands:
        return []
    fence = "```"
    while fence in "".join(commands):
        fence += "`"
    return [f"Command{'s' if len(commands) > 1 else ''}:", "", fence, *commands, fence, ""]


def _as_typed(command: str) -> str:
    """A command without the folder that `pursuit` is installed in."""
    first, space, rest = command.partition(" ")
    path = Path(first)
    ours = path.name == "pursuit" or path.parts[-3:] == ("train", "commands", "main.py")
    return f"pursuit{space}{rest}" if ours else command
