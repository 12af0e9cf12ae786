"""Pages of the reference that are made from the code: the command line and the settings."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import inspect
import io
import os
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from typing import Any


def command_line() -> str:
    """The help of every command, as it is printed 100 columns wide."""
    from train.commands.main import COMMANDS, main

    os.environ.update(COLUMNS="100", NO_COLOR="1")
    parts = ["# Command line", "The output of `pursuit COMMAND --help`, generated at build time."]
    for name in ("", *COMMANDS):
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
            main([*name.split(), "--help"])
        parts.append(f"## pursuit {name}".rstrip())
        parts.append(f"```text\n{shown.getvalue().rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def settings() -> str:
    """A table for every class of settings, with names, defaults and meanings."""
    from train.settings import algorithms, curricula, run, self_play, task

    groups = {
        "Tasks": (task.TaskSettings, task.ReacherSettings),
        "A run": (run.TrainSettings,),
        "Self-play": (self_play.SelfPlaySettings,),
        "Algorithms": tuple(algorithms.HYPERPARAMETERS.values()),
        "Curricula": tuple(dict.fromkeys(curricula.CURRICULA.values())),
    }
    parts = [
        "# Settings",
        "Generated from the dataclasses at build time. The names are those of `config.json`, of "
        "sweep files and of Python; on the command line `num_games` is `--num-games`.",
    ]
    for title, forms in groups.items():
        parts.append(f"## {title}")
        for form in forms:
            parts += [f"### {form.__name__}", inspect.getdoc(form) or "", table(form)]
    return "\n\n".join(parts) + "\n"


def table(form: type[Any]) -> str:
    """The fields of a dataclass."""
    meanings = dict(documented(form))
    rows = ["| name | default | meaning |", "|---|---|---|"]
    for field in dataclasses.fields(form):
        default = field.default
        if default is dataclasses.MISSING:
            continue
        meaning = " ".join(meanings.get(field.name, "").split()).replace("|", "\\|")
        rows.append(f"| `{field.name}` | `{default!r}` | {meaning} |")
    return "\n".join(rows)


def documented(form: type[Any]) -> Iterator[tuple[str, str]]:
    """Names of fields with the docstrings below them, those of base classes first."""
    for base in reversed(form.__mro__):
        if not dataclasses.is_dataclass(base):
            continue
        tree: Any = ast.parse(textwrap.dedent(inspect.getsource(base)))
        for name, text in pairwise(tree.body[0].body):
            if (
                isinstance(name, ast.AnnAssign)
                and isinstance(name.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
            ):
                yield name.target.id, str(text.value.value)
