"""Sweeps: a small TOML file of settings, lists of values and seeds becomes a list of runs."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import sys
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pursuit.parts import check_trusted
from train.experiments.kinds import KINDS, is_complete, open_run, read_settings, write_config
from train.files import write_json, write_text
from train.runs.folder import CHECKPOINT, CONFIG, RUN
from train.runs.loop import Run
from train.runs.provenance import provenance
from train.runs.tasks import task_of
from train.settings.checks import check

EXPERIMENTS = Path(__file__).with_name("files")
VERSIONS = ("short", "full")
KEYS = frozenset(
    ("title", "kind", "settings", "grid", "variants", "seeds", "search", "report", "exact")
) | {"episodes"}
OVERRIDES = frozenset({"settings", "grid", "seeds", "episodes", "search", "exact"})
HINTS, LABEL = "sweep.json", "run.json"
ERROR, PROGRESS, STOPPED = "error.txt", "progress.txt", "stopped_early.json"


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep.

    Attributes:
        name: of its folder: readable, with a fingerprint of the complete settings at the end.
        kind: of run, one of `KINDS`.
        settings: all of them.
        label: what the sweep file says of this run: the names that vary, and `variant`.
    """

    name: str
    kind: str
    settings: Any
    label: dict[str, Any]


@dataclass(frozen=True)
class Sweep:
    """A sweep file, checked and multiplied out.

    Attributes:
        title: of the reports.
        runs: all combinations, in the order of the file.
        episodes: of each final evaluation.
        report: hints for `train.experiments.report`: "x", "group".
        exact: tables that need no learning: "mazes" and "goals".
        scheduler: "asha" stops the worst early, on Ray; None runs everything to its end.
    """

    title: str
    runs: tuple[SweepRun, ...]
    episodes: int
    report: dict[str, Any]
    exact: dict[str, Any]
    scheduler: str | None


def shipped(folder: Path = EXPERIMENTS) -> list[str]:
    """The names of the shipped files."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def load_sweep(name: str, version: str | None = None) -> Sweep:
    """Read a sweep file and multiply it out; nothing is run.

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full", where the file has both; short if left out.

    Raises:
        ValueError: no such file, no TOML, an unknown key, an empty list, a version that the file
            does not have, or a combination that cannot run.
    """
    path, content = read_file(name, EXPERIMENTS, "sweep")
    try:
        return multiply_out(choose_version(content, version), path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_file(name: str, folder: Path, kind: str) -> tuple[Path, dict[str, Any]]:
    """The path and the content of a TOML file, or of the one of that name in `folder`.

    Raises:
        ValueError: no such file, no TOML, or parts named that are neither ours nor allowed.
    """
    path, names = Path(name), shipped(folder)
    if not path.exists() and name in names:
        path = folder / f"{name}.toml"
    check(path.is_file(), f"{name}: no such {kind} file; shipped are {', '.join(names)}")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not TOML: {error}") from None
    check_trusted(path, content)
    return path, content


def choose_version(content: dict[str, Any], version: str | None) -> dict[str, Any]:
    """The content with the chosen version laid over it."""
    for name in content:
        check(
            name in KEYS or name in VERSIONS,
            f"unknown key {name!r}; one of {', '.join(sorted({*KEYS, *VERSIONS}))}",
        )
    check(version in (None, *VERSIONS), f"unknown version {version!r}; short or full")
    has = [name for name in VERSIONS if name in content]
    check(version is None or version in has, f"no version {version!r}; it has {has or 'none'}")
    result = {name: value for name, value in content.items() if name not in VERSIONS}
    chosen = version or (has[0] if has else None)
    for name, value in content.get(chosen, {}).items() if chosen else ():
        check(
            name in OVERRIDES,
            f"unknown key {name!r} in [{chosen}]; one of {', '.join(sorted(OVERRIDES))}",
        )
        before = result.get(name)
        both = isinstance(value, dict) and isinstance(before, dict)
        result[name] = {**before, **value} if both else value  # type: ignore[dict-item]
    return result


def multiply_out(content: dict[str, Any], stem: str) -> Sweep:
    """All combinations as checked settings."""
    kind = content.get("kind", RUN)
    check(kind in KINDS, f"unknown kind {kind!r}; one of {', '.join(KINDS)}")
    common = _table(content, "settings")
    grid = _table(content, "grid")
    search = dict(_table(content, "search"))
    variants = content.get("variants", [{}])
    seeds = content.get("seeds", [0])
    for name, values in (*grid.items(), ("seeds", seeds), ("variants", variants)):
        check(isinstance(values, list), f"{name}={values!r}; give a list of values")
        check(bool(values), f"{name} is an empty list; give at least one value")
    names = [variant.get("name") for variant in variants]
    check(
        variants == [{}] or (None not in names and len(set(names)) == len(names)),
        f"variants need a name each, all different; these are {names}",
    )
    scheduler = search.pop("scheduler", None)
    check(scheduler in (None, "asha"), f"unknown scheduler {scheduler!r}; asha")
    drawn = draw_samples(search)
    varying = {*grid, *(name for variant in variants for name in variant), *drawn[0]} - {"name"}
    has_runs = bool(common or grid or variants != [{}])
    runs: dict[str, SweepRun] = {}
    for values in itertools.product(*grid.values()) if has_runs else ():
        for variant, sample, seed in itertools.product(variants, drawn, seeds):
            label = dict(zip(grid, values, strict=True)) | variant | sample
            flat = common | {k: v for k, v in label.items() if k != "name"} | {"seed": seed}
            for name in variant.keys() & {*grid, *sample}:
                raise ValueError(f"{name!r} is set by a variant and by the grid or search; by one")
            try:
                settings = KINDS[kind].settings_of(**{"threads": 1, **flat})
            except ValueError as error:
                told = ", ".join(f"{k}={v!r}" for k, v in (label | {"seed": seed}).items())
                raise ValueError(f"the combination {told} cannot run: {error}") from None
            if "name" in label:
                label["variant"] = label.pop("name")
            run = SweepRun(run_name(kind, settings, label), kind, settings, label)
            runs.setdefault(run.name.rsplit("-", 1)[1], run)  # a combination named twice runs once
    exact = _table(content, "exact")
    check(has_runs or bool(exact), "nothing to do; give [settings] and [grid], or [exact]")
    episodes = content.get("episodes", 1000)
    check(type(episodes) is int and episodes >= 2, f"episodes={episodes!r}; at least 2")
    report = _report_hints(content, sorted(varying))
    return Sweep(
        content.get("title", stem),
        tuple(runs.values()),
        episodes,
        report,
        exact,
        scheduler,
    )


def _table(content: dict[str, Any], name: str) -> dict[str, Any]:
    value = content.get(name, {})
    check(isinstance(value, dict), f"[{name}] is {value!r}; give a table of names and values")
    return dict(value)


def _report_hints(content: dict[str, Any], varying: list[str]) -> dict[str, Any]:
    """What goes on the axis and what is a curve of its own; `variant` where there are variants."""
    hints = _table(content, "report")
    for name in hints:
        check(name in ("x", "group"), f"unknown key {name!r} in [report]; x or group")
    x = hints.get("x")
    group = hints.get("group")
    if group is None:
        group = ["variant"] if content.get("variants") else [n for n in varying if n != x]
    check(isinstance(group, list), f"group={group!r}; give a list of names")
    return {"x": x, "group": group}


def draw_samples(search: dict[str, Any]) -> list[dict[str, Any]]:
    """The samples of a random search, drawn once: the same whoever runs them.

    Args:
        search: "samples" and "seed", and for every searched setting {low, high, scale="log" or
            "linear", whole=false} or {choices=[...]}.

    Returns:
        One dict for each sample; [{}] where there is no search.

    Raises:
        ValueError: something else, or an empty range.
    """
    if not search:
        return [{}]
    given = dict(search)
    samples, seed = given.pop("samples", 10), given.pop("seed", 0)
    check(type(samples) is int and samples >= 1, f"samples={samples!r}; a number of at least 1")
    check(bool(given), "[search] names no setting; give learning_rate = {low=1e-4, high=1e-2}, say")
    generator = np.random.default_rng(seed)
    for name, spec in given.items():
        known = ({"choices"}, {"low", "high"}, {"low", "high", "scale"}, {"low", "high", "whole"})
        check(
            isinstance(spec, dict) and set(spec) - {"whole", "scale"} in known[:2],
            f"search of {name}={spec!r}; give {{low=, high=, scale='log'}} or {{choices=[]}}",
        )
        if "choices" in spec:
            check(bool(spec["choices"]), f"choices of {name} is an empty list")
        else:
            check(spec["low"] < spec["high"], f"search of {name}: low is not below high")
            check(
                spec.get("scale") != "log" or spec["low"] > 0,
                f"search of {name}: log needs low > 0",
            )
    drawn = []
    for _ in range(samples):
        sample: dict[str, Any] = {}
        for name, spec in given.items():
            if "choices" in spec:
                sample[name] = spec["choices"][int(generator.integers(len(spec["choices"])))]
                continue
            low, high = spec["low"], spec["high"]
            if spec.get("scale", "linear") == "log":
                value = float(np.exp(generator.uniform(np.log(low), np.log(high))))
            else:
                value = float(generator.uniform(low, high))
            sample[name] = round(value) if spec.get("whole") else float(f"{value:.4g}")
        drawn.append(sample)
    return drawn


def fingerprint(kind: str, settings: Any) -> str:
    """Ten hexadecimal digits of everything that decides the outcome of a run."""
    maze = task_of(settings.task).mazes[0]
    plain = {"kind": kind, **asdict(settings), "maze_text": maze.to_text()}
    if parts := provenance(settings):
        plain["parts"] = parts
    text = json.dumps(plain, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def run_name(kind: str, settings: Any, label: dict[str, Any]) -> str:
    """A readable folder name that no other settings have."""
    parts = [str(value) for value in label.values()] or [kind]
    text = "-".join([*parts, f"seed{settings.seed}"])
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text)[:80] + "-" + fingerprint(kind, settings)


def prepare(sweep: Sweep, out: Path) -> list[tuple[SweepRun, Path]]:
    """Make the folders of all runs, with their `config.json`; those there already are checked.

    Returns:
        Every run with its folder.

    Raises:
        ValueError: `out` is something else, or holds a run of other settings or another version.
    """
    check(not out.is_file(), f"{out}: a file; give a folder")
    there = [path.name for path in out.iterdir()] if out.is_dir() else []
    if set(there) - {".lock", "exact.md"} and "runs" not in there:
        raise ValueError(f"{out}: not empty, and no sweep; give a new folder")
    folders = [(run, out / "runs" / run.name) for run in sweep.runs]
    for run, folder in folders:
        if (folder / CONFIG).exists():
            check(
                fingerprint(*read_settings(folder)) == fingerprint(run.kind, run.settings),
                f"{folder}: holds a run of other settings than its name says; remove that folder",
            )
    for run, folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / CONFIG).exists():
            write_config(run.kind, run.settings, folder)
        write_json(folder / LABEL, run.label)
    names = [run.name for run in sweep.runs]
    write_json(out / HINTS, {"title": sweep.title, **sweep.report, "runs": names})
    return folders


def status_of(folder: Path) -> str:
    """complete, failed, stopped (early, by a scheduler), interrupted or new."""
    if is_complete(folder):
        return "complete"
    if (folder / ERROR).exists():
        return "failed"
    if (folder / STOPPED).exists():
        return "stopped"
    return "interrupted" if (folder / CHECKPOINT).exists() else "new"


def perform(folder: Path, episodes: int) -> None:
    """Do the run in `folder`, or go on with it, to its results; in a process of its own."""
    run = open_run(folder)

    def report(run: Run, row: dict[str, float]) -> None:
        if row:
            write_text(folder / PROGRESS, str(run.progress))

    if run.progress < 1.0:
        run.train(report)
    if not run.stopped:
        run.results(episodes)


if __name__ == "__main__":
    perform(Path(sys.argv[1]), int(sys.argv[2]))
