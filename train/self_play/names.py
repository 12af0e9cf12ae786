"""Short and unique names for the entries of a league."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from pursuit.validation import check
from train.runs.folder import CONFIG


def entry_names(
    entries: Sequence[str], is_agent: Callable[[str], bool], chosen: Sequence[str] = ()
) -> list[str]:
    """A name for each entry: the chosen ones, or the shortest unique ones.

    Agents keep their names. A folder has the shortest end of its path that is not the end of
    another folder or the name of an agent. The name of one side of self-play includes the run.

    Args:
        entries: names of agents and paths of folders.
        is_agent: whether an entry is the name of an agent.
        chosen: a name for each entry in their order, or empty.

    Raises:
        ValueError: the same entry twice; chosen names that are too few, too many or repeated; names
            as `check_name`.
    """
    paths = {entry: Path(os.path.realpath(entry)) for entry in entries if not is_agent(entry)}
    for number, entry in enumerate(entries):
        same = [e for e in entries[:number] if e == entry or paths.get(e, e) == paths.get(entry)]
        check(not same, f"two entries are called {entry!r}; give it once")
    if chosen:
        check(
            len(chosen) == len(entries),
            f"{len(chosen)} names for {len(entries)} entries; give one for each, in their order",
        )
        for name in chosen:
            check(list(chosen).count(name) == 1, f"two names are {name!r}; give different ones")
    agents = {entry for entry in entries if entry not in paths}
    found = list(chosen) or [
        _name_of(paths[entry], [p for e, p in paths.items() if e != entry], agents)
        if entry in paths
        else entry
        for entry in entries
    ]
    for name in found:
        check_name(name)
    return found


def check_name(name: str) -> None:
    """ValueError unless a line of tables and figures can have this name: pictures as SVG are not
    well-formed with control characters."""
    good = bool(name.strip()) and name.isprintable()
    check(good, f"name {name!r} is empty, or has characters that are not printable; give another")


def _name_of(path: Path, others: Sequence[Path], agents: set[str]) -> str:
    """The name of a folder; that of one side begins with the name of its run."""
    run = _run_of(path)
    rest = [other for other in map(_run_of, others) if other != run]
    name = _end_of(run, rest, agents)
    return name if run == path else f"{name}/{path.name}"


def _run_of(path: Path) -> Path:
    """The folder of the run of which a folder is one side, or the folder itself."""
    return path.parent if (path.parent / CONFIG).exists() else path


def _end_of(path: Path, others: Sequence[Path], agents: set[str]) -> str:
    """The shortest end of a path that is not the end of another and not the name of an agent."""
    parts = path.parts
    for length in range(1, len(parts)):
        end = parts[-length:]
        name = "/".join(end)
        if name not in agents and all(other.parts[-length:] != end for other in others):
            return name
    return str(path)
