"""The methods table of runs: settings, results and versions from their files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from train.experiments.forms import read_label
from train.experiments.sweep import flat_plain
from train.files import read_json
from train.reports.tables import plain_table
from train.runs.folder import CONFIG, RESULTS, RUN, SIDE, load_results, read_config
from train.runs.provenance import COMMAND, recorded_parts
from train.settings.task import learning_agent

METHODS = "methods.md"
METHODS_LINE = f"How these runs were made: [{METHODS}]({METHODS})."
OUR_PATH = re.compile(r"^\S*(bin/pursuit|commands/main\.py)(?= |$)")
"""The path of `pursuit` in a recorded command, which depends on the installation."""
SPANS = ("frames trained", "seconds trained")
"""Entries given as minimum and maximum; of others all different values are listed."""


def methods(folders: Sequence[Path | str], title: str = "# Methods") -> str:
    """A Markdown table of settings, results and commands of runs, with each value once.

    Args:
        folders: of the runs, at least one.
        title: the heading.

    Raises:
        ValueError: a folder contains no run, or a damaged one.
    """
    runs = [facts_of(Path(folder)) for folder in folders]
    found = {"runs": [len(runs)]}
    for name in dict.fromkeys(name for run in runs for name in run):
        values = [run[name] for run in runs if name in run]
        found[name] = [min(values), max(values)] if name in SPANS else values
    return as_page({name: listed(map(text_of, values)) for name, values in found.items()}, title)


def facts_of(folder: Path) -> dict[str, Any]:
    """The entries of one run, by name.

    Raises:
        ValueError: the folder contains no run, or a damaged one.
    """
    kind, plain = read_config(folder)
    results = load_results(folder) if (folder / RESULTS).exists() else {}
    label = read_label(folder)
    found = {name: value for name, value in flat_plain(plain).items() if value is not None}
    if "maze" in found:
        found["maze"] = results.get("maze") or label.get("maze") or found["maze"]
    names = ("curriculum_mazes", "opponent", "chaser", "evader", "variant")
    found |= {"kind": kind} | {name: label[name] for name in names if name in label}
    if kind == RUN and "role" in found:
        found["role"] = learning_agent(found["task"], found["role"])
    for setting, part in recorded_parts(folder / CONFIG).items():
        found[f"SHA-256 of the source of {setting}"] = part["sha256"] or "no source"
    if results:
        found["frames trained"] = results["frames"]
        found["seconds trained"] = round(results["seconds"], 1)
        if kind == RUN:
            score = results["evaluation"]
            played = f"{score['episodes']:,} episodes, held-out seeds"
            found["evaluation"] = "exact, over all starts" if score["exact"] else played
        found["objective"] = f"{results['objective']['column']} ({results['objective']['unit']})"
        found["complete"] = not results["interrupted"]
        found |= where_they_ran(results)
    command = str(read_json(folder / CONFIG).get(COMMAND, ""))
    return found | {"command": OUR_PATH.sub("pursuit", command)}


def league_methods(content: Mapping[str, Any], folders: Sequence[Path]) -> str:
    """The methods tables of a league and of its runs, as Markdown.

    Args:
        content: of `league.json`.
        folders: of its runs; a side of self-play stands for its whole run.

    Raises:
        ValueError: a folder contains no run, or a damaged one.
    """
    names = ("task", "maze", "max_steps", "greedy", "opponent_epsilon", "games", "seed", "command")
    found = {name: text_of(content[name]) for name in names}
    found["payoffs"] = "mean steps until capture, exact over all starts"
    if any(half for row in content["ci95"] for half in row):
        found["payoffs"] += f"; values with ± are means of {content['games']} games (95 % interval)"
    found["ratings"] = (
        f"from {content['games']} games per pair with the same held-out starts: Elo by maximum "
        "likelihood (Bradley and Terry) with bootstrap intervals, Nash averaging (Balduzzi et al., "
        "2018)"
    )
    page = as_page(found | where_they_ran(content), "# Methods")
    # The run of a side of self-play is in the parent folder.
    runs = dict.fromkeys(
        folder.parent if read_config(folder)[0] == SIDE else folder for folder in folders
    )
    return page + (f"\n{methods(list(runs), '## Runs')}" if runs else "")


def where_they_ran(results: Mapping[str, Any]) -> dict[str, str]:
    """The versions and the machine in results."""
    return {
        name: ", ".join(f"{key} {value}" for key, value in results[name].items() if value)
        for name in ("versions", "machine")
    }


def as_page(found: Mapping[str, str], title: str) -> str:
    """Names and values as a table under a heading."""
    rows = [{"setting": name, "value": value} for name, value in found.items()]
    return f"{title}\n\n{plain_table(rows).markdown()}\n"


def listed(values: Iterable[str]) -> str:
    """All different values as text."""
    return " or ".join(dict.fromkeys(values))


def text_of(value: Any) -> str:
    """A value as text."""
    if isinstance(value, list | tuple):
        return " ".join(map(text_of, value)) or "none"
    if isinstance(value, float):
        return f"{value:g}"
    return "given as text in config.json" if "\n" in str(value) else str(value)
