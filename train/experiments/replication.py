"""Replications: studies with claims, from their file to their runs."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import msgspec

from pursuit.mazes.maze import Maze
from pursuit.mazes.sources import decoded, read_bytes
from pursuit.plugins import reading
from pursuit.validation import check, one_of, unknown
from train.experiments.claims import cells_of_table, in_cell
from train.experiments.expansion import load_study
from train.experiments.rows import flat_plain
from train.experiments.runs import TUNING, Study
from train.experiments.stages import Stage, stages_of_search
from train.experiments.study import (
    VERSIONS,
    Claim,
    ClaimedStudy,
    ReplicationFile,
    StudyFile,
    Table,
    Tuning,
    read_file,
)
from train.experiments.tuning import TuningSearch, tuning_search_of
from train.files import begins_with, read_json, write_json
from train.reports.tables import in_markdown

STUDIES, RULES_KEPT, PAGE = "studies", "rules.json", "replication.md"
BY_SIZE = re.compile(r"(\d+)x(\d+)")


@dataclass(frozen=True)
class Replication:
    """The selected studies of a validated replication file.

    Attributes:
        name: of the file.
        title: of the report.
        version: "short" or "full".
        studies: the selected studies, in the order of the file.
        left_out: the ids of studies that only the other version includes.
        tuning: the search; None if no study needs it.
        mazes: paths of user-defined mazes, by the names of the shipped mazes that they replace.
    """

    name: str
    title: str
    version: str
    studies: tuple[ClaimedStudy, ...]
    left_out: tuple[str, ...]
    tuning: Tuning | None
    mazes: Mapping[str, str]


def load_replication(
    wanted: Sequence[str] = ("all",),
    version: str = "short",
    mazes: Path | None = None,
    file: str = "thesis",
) -> Replication:
    """Read and validate a replication file.

    Args:
        wanted: the ids of studies, or "all".
        version: "short" or "full".
        mazes: a folder of maze files that replace the shipped mazes of the same size.
        file: a path, or the name of a shipped file.

    Raises:
        ValueError: unknown file, study or version, a study that the version does not include, or a
            folder without mazes or with several of one size.
    """
    path, content = read_file(file, "replication", ReplicationFile)
    one_of("version", version, VERSIONS)
    ids = [study.id for study in content.studies]
    for name in set(wanted) - {"all"}:
        check(name in ids, unknown("study", name, ids, "give all, or some of"))
    chosen = [s for s in content.studies if ("all" in wanted or s.id in wanted)]
    for study in chosen if "all" not in wanted else ():
        check(
            version in study.versions,
            f"study {study.id!r} is part of {', '.join(study.versions)} only; give --version "
            f"{study.versions[0]}",
        )
    left_out = tuple(study.id for study in chosen if version not in study.versions)
    chosen = [study for study in chosen if version in study.versions]
    own = {} if mazes is None else mazes_by_size(mazes)
    tuning = content.tuning if any(study.tuned for study in chosen) else None
    return Replication(path.stem, content.title, version, tuple(chosen), left_out, tuning, own)


def mazes_by_size(folder: Path) -> dict[str, str]:
    """The maze files of a folder by size, such as "5x5"; other files are ignored.

    Raises:
        ValueError: no folder, no maze in it, or two of one size.
    """
    check(folder.is_dir(), f"{folder}: no such folder; give one with maze files")
    found: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        if not path.is_file():
            continue
        try:
            maze = Maze.from_text(decoded(read_bytes(path), path))
        except ValueError:
            continue
        name = f"{maze.height}x{maze.width}"
        check(
            name not in found,
            f"{folder}: {found.get(name)} and {path} are both {name}; keep one of each size",
        )
        found[name] = str(path.resolve())
    check(bool(found), f"{folder}: contains no maze file; give a folder with maze files")
    return found


# -- runs ------------------------------------------------------------------------------------------


def replication_stages(plan: Replication, out: Path) -> list[Stage]:
    """The search, then every study; each with the settings found when it starts."""
    stages, search = list[Stage](), None
    if plan.tuning is not None:
        search = tuning_search_of(plan.tuning, plan.version, out / TUNING)
        with reading(plan.name):
            stages += stages_of_search(search, search.study(0))
    for study in plan.studies:
        own = search if study.tuned else None
        expand = partial(runs_of_study, study, plan, own)
        stages.append(Stage(study.id, expand, out / STUDIES / study.id, own))
    return stages


def runs_of_study(
    study: ClaimedStudy, plan: Replication, search: TuningSearch | None = None
) -> Study:
    """The runs of a study, with the settings that a search has found so far.

    Raises:
        ValueError: an invalid study file, or a claim about runs that it does not have.
    """
    kind, name = ("ablation", study.ablation) if study.ablation else ("sweep", study.sweep)
    change = partial(with_own_mazes, mazes=plan.mazes)
    tuned = None if search is None else search.chosen()
    found = load_study(str(name), kind, plan.version, change, tuned)
    names, rows = {path: name for name, path in plan.mazes.items()}, []
    for run in found.runs:
        row = {**flat_plain(asdict(run.settings)), **run.files, **run.label}
        rows.append(row | {"maze": names.get(str(row.get("maze")), row.get("maze"))})
    for claim in study.claims:
        for cell in [cell for table in (claim.of, *claim.than) for cell in cells_of_table(table)]:
            check(
                bool(in_cell(rows, cell)),
                f"study {study.id!r}: the claim {claim.text!r} is about {cell}, but "
                f"{study.sweep or study.ablation} has no such run; correct the claim or the file",
            )
    return found


def with_own_mazes(file: StudyFile, mazes: Mapping[str, str]) -> StudyFile:
    """The same study file with user-defined mazes in place of shipped ones."""

    def other(table: Table) -> Table:
        if not mazes or "maze" not in table:
            return table
        value = table["maze"]
        names = value if isinstance(value, list) else [value]
        lacking = [n for n in names if BY_SIZE.fullmatch(n) and n not in mazes]
        check(
            not lacking,
            f"--mazes has {', '.join(mazes)}, but not {', '.join(lacking)}; add these sizes",
        )
        found = [mazes.get(name, name) for name in names]
        return {**table, "maze": found if isinstance(value, list) else found[0]}

    return msgspec.structs.replace(file, settings=other(file.settings), grid=other(file.grid))


# -- rules -----------------------------------------------------------------------------------------


def keep_rules(plan: Replication, out: Path) -> None:
    """Write the rules that decide the claims to a file, before the first run."""
    path = out / RULES_KEPT
    kept = read_json(path) if path.exists() else {}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    for study in plan.studies:
        if study.id not in kept:
            kept[study.id] = {"written": now, "claims": rules_of_claims(study.claims)}
    write_json(path, kept)


def rules_of_claims(claims: Sequence[Claim]) -> list[Table]:
    """Claims as plain values, without the interpretations of their results."""
    plain: list[Table] = msgspec.to_builtins(claims)
    return [{name: value for name, value in claim.items() if name != "cause"} for claim in plain]


def changed_rules(study: ClaimedStudy, out: Path) -> str:
    """A note if the rules of a study were changed after its first run; else empty."""
    path = out / RULES_KEPT
    kept = read_json(path).get(study.id) if path.exists() else None
    if kept is None:
        return ""
    with contextlib.suppress(msgspec.ValidationError):  # claims of an older format
        before = msgspec.convert(kept["claims"], list[Claim])
        if rules_of_claims(before) == rules_of_claims(study.claims):
            return ""
    return f"The rules of this study were changed after its first run ({kept['written']})."


def is_replication(plan: Replication, out: Path) -> bool:
    """Whether `out` is the folder of this replication, or of one with the same title."""
    page = out / "report" / PAGE
    own = not page.exists() or begins_with(page, f"# {in_markdown(plan.title)}\n")
    return own and (out / RULES_KEPT).exists()
