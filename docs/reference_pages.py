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
    parts = [
        "# Command line",
        "The output of `pursuit COMMAND --help`, of `train` and `self-play` with `--help-all`, "
        "generated at build time.",
    ]
    for name in ("", *COMMANDS):
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
            main([*name.split(), "--help-all" if name in ("train", "self-play") else "--help"])
        parts.append(f"## pursuit {name}".rstrip())
        parts.append(f"```text\n{shown.getvalue().rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def settings() -> str:
    """Tables of all settings, in the groups of the help, with names, defaults and meanings."""
    from train.settings import algorithms, curricula, run, self_play, task
    from train.settings.groups import GROUPS, group_of

    forms: tuple[type[Any], ...] = (
        run.TrainSettings,
        self_play.SelfPlaySettings,
        task.TaskSettings,
        task.ReacherSettings,
        task.SmallGameSettings,
        *dict.fromkeys(algorithms.HYPERPARAMETERS.values()),
        *dict.fromkeys(curricula.CURRICULA.values()),
    )
    parts = [
        "# Settings",
        "Generated from the dataclasses at build time, in the groups of `--help-all`. The names "
        "are those of `config.json`, of sweep files, of files for `--config` and of Python; on the "
        "command line `num_games` is `--num-games`.",
    ]
    for title in GROUPS:
        of_group = [
            (form, {each.name for each in dataclasses.fields(form)
                    if group_of(form, each.name) == title and has_default(each)})
            for form in forms
        ]  # fmt: skip
        if any(names for _, names in of_group):
            parts.append(f"## {title}")
        for form, names in of_group:
            if names:
                parts += [f"### {form.__name__}", inspect.getdoc(form) or "", table(form, names)]
    return "\n\n".join(parts) + "\n"


def has_default(field: dataclasses.Field[Any]) -> bool:
    """Whether a table shows this field: others are settings themselves."""
    return field.default is not dataclasses.MISSING


def table(form: type[Any], names: set[str]) -> str:
    """These fields of a dataclass."""
    meanings = dict(documented(form))
    rows = ["| name | default | meaning |", "|---|---|---|"]
    for field in dataclasses.fields(form):
        if field.name in names:
            meaning = " ".join(meanings.get(field.name, "").split()).replace("|", "\\|")
            rows.append(f"| `{field.name}` | `{field.default!r}` | {meaning} |")
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
