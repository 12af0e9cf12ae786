"""Table of docs/results/frames_and_states.md: frames to a gap by the number of states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from train.experiments.committed import grouped, read_table
from train.reports.tables import plain_table

Row = dict[str, Any]


def tables(data: Path) -> dict[str, str]:
    """The table by its title."""
    found = []
    for size, own in sorted(grouped(read_table(data / "runs.csv"), "size").items()):
        line: Row = {"maze": f"{size}x{size}", "states": f"{own[0]['states']:,}"}
        for learner, runs in sorted(grouped(own, "learner").items(), reverse=True):
            line[f"{learner}, thousand frames"] = ", ".join(
                f"{row['frames'] / 1e3:,.0f}" for row in runs
            )
        found.append(line)
    return {"frames": plain_table(found).markdown()}
