"""Where runs ran and by what command, in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from train.result_table import ResultTable, one_line, words
from train.runs.provenance import Records


def where_it_ran(results: Sequence[Mapping[str, Any]]) -> str:
    """One sentence on the versions and the machines in results."""
    versions = list(dict.fromkeys(_versions(each["versions"]) for each in results))
    machines = list(dict.fromkeys(map(_machine, results)))
    return f"Software: {'; or '.join(versions)}. Machine: {'; or '.join(machines)}."


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
    rows = dict.fromkeys(
        (setting, str(part["name"]), part["sha256"] or "no source")
        for records in given
        for setting, part in records.items()
    )
    if not rows:
        return []
    plain = [dict(zip(heads, row, strict=True)) for row in rows]
    table = ResultTable(plain, [words(head) for head in heads])
    return ["User-defined parts:", "", table.markdown(), ""]


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
