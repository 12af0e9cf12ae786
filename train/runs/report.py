"""The report of a run: a page with results, learning curve, replays and settings."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from pursuit.replays.viewer.data import Builder
from train.evaluation.hidden_contest import Certificate
from train.evaluation.recordings import add_compared
from train.evaluation.score_table import score_table
from train.evaluation.scores import AnyContest, Reference, Score, beside_of
from train.evaluation.team_contest import describe_team
from train.files import Plain, read_json
from train.reports.pages import (
    PLAYER_ELEMENT,
    details,
    embedded_picture,
    pairs,
    section,
    write_page,
)
from train.reports.tables import in_markdown
from train.runs.folder import CONFIG, CURVE, REPLAYS, REPORT
from train.settings.run import AgentSettings

EPISODES = 4
"""Number of episodes of the evaluation in the replay."""

LEARNED = 0.9
"""Least success rate for which `describe_loops` gives advice."""


def write_report(
    folder: Path,
    settings: AgentSettings,
    contest: AnyContest,
    policy: Any,
    results: Plain,
    path: Path | None = None,
) -> Path:
    """Write `report.html` into the folder of a run, and where there are replays `replays.json`.

    Args:
        folder: of the run.
        settings: of the run.
        contest: of the evaluation.
        policy: the trained policy, as evaluated.
        results: the content of `results.json`.
        path: of the page, if it is outside the folder; then no replays are written.

    Raises:
        OSError: they cannot be written.
    """
    games = {f"episode {number + 1}": number for number in range(EPISODES)}
    scores, builder = [Score(**score) for score in results["scores"]], Builder()
    is_solved = any(score.name.startswith("optimal") for score in scores)
    shown = (games, settings.algorithm, settings.observation, is_solved)
    replay = add_compared(builder, contest, policy, *shown)
    if path is None and replay is not None:
        replay.save(folder / REPLAYS)
    title = contest.line().split(", at most")[0]
    table = score_table(
        scores, certificate_in(results), contest.measure, contest.beside, contest.success
    )
    about = f"Run {folder.name}: {settings.algorithm}, curriculum {settings.curriculum}."
    parts = [
        in_markdown(about),
        in_markdown(summary(results)),
        PLAYER_ELEMENT,
        *section("Scores", table.markdown()),
        *(section("Team", *describe_team(results["team"])) if "team" in results else ()),
        *section(
            "Learning", embedded_picture(folder / CURVE, "steps, gap and curriculum over training")
        ),
        *section("Settings and command", *provenance_parts(folder, settings, results)),
    ]
    path = path or folder / REPORT
    write_page(path, title, parts, builder.data(title))
    return path


def of_solved(evaluation: Plain) -> str:
    """The unsolved share and the gap of solved starts, as text; empty if all were solved."""
    unsolved, gap = evaluation.get("unsolved_share"), evaluation.get("solved_gap")
    if not unsolved or gap is None:
        return ""
    return f" ({100 * unsolved:.1f} % unsolved; gap of the solved {100 * gap:+.2f} %)"


def describe_loops(content: Plain) -> str:
    """Advice for a runner with a greedy policy that loops from starts that the sampled one solves.

    Empty if there are no such starts, or if its success rate is low.
    """
    solved = {score["name"]: score["success_rate"] for score in content["scores"]}
    greedy, drawn = solved.get("learned"), solved.get("learned, sampled")
    by_steps = content["objective"]["column"] == "mean_steps"
    if content["role"] != "runner" or not by_steps or greedy is None or drawn is None:
        return ""
    loops = f"{100 * (drawn - greedy):.1f}"
    if greedy < LEARNED or drawn <= greedy or loops == "0.0":
        return ""
    return (
        f"the greedy policy loops forever from {loops} % of the starts that the sampled policy "
        "solves; use --evaluate sampled, or in mazes larger than 5x5 --frame-stack 2, which avoids "
        "most loops"
    )


def headline(results: Plain) -> str:
    """The objective and its best known value: goals or return, if it is not steps."""
    found, column = results["evaluation"], results["objective"]["column"]
    name, unit = column.removeprefix("mean_"), results["objective"]["unit"]
    text = f"Learned{beside_of(results.get('teammates', {}))}: {unit} {found[column]:.3f}"
    best = found.get(f"optimal_{name}")
    if best is not None:
        text += f", optimum on the same starts {best:.3f}: {found[f'{name}_regret']:z.3f} "
        text += "above it" if results["objective"]["less_is_better"] else "below it"
    return text


def summary(results: Plain) -> str:
    """The result in one sentence."""
    found = results["evaluation"]
    beside = beside_of(results.get("teammates", {}))
    text = f"Learned{beside}: {found['mean_steps']:.3f} steps"
    if results["objective"]["column"] != "mean_steps":
        text = f"{headline(results)}; {found['mean_steps']:.3f} steps"
    elif found["optimality_gap"] is not None:
        exact = results.get("least", {}).get("share_exact", 1.0) == 1.0
        optimum = "optimum" if exact else "lower bound of the optimum"
        text += (
            f"; {optimum} {found['optimal_steps']:.3f}; gap {100 * found['optimality_gap']:+.2f} %"
            f"{of_solved(found)}"
        )
    if "certified_lower" in found:
        text += (
            f", {found['discounted_steps']:.3f} discounted by {found['discount']:g} per step; "
            f"certified optimum with limited view: {found['certified_lower']:.4f} to "
            f"{found['certified_upper']:.4f}"
        )
    held = results.get("reference") or {}
    if held.get("kind") in ("bound", "best known"):
        text += f"; {Reference(**held).line()}"
    gap, missing = found.get("objective_gap"), found.get("return_gap")
    if missing is not None:
        text += f" (a policy optimal for the training objective: {missing:z.4f} below the optimum)"
    elif gap is not None:
        text += f" (a policy optimal for the training objective: gap {100 * gap:+.2f} %)"
    text += f". {results['frames']:,} frames in {results['seconds']:.1f} s"
    text += " of processor time" if results.get("clock") == "processor" else ""
    return text + (", interrupted." if results["interrupted"] else ".")


def certificate_in(results: Plain) -> Certificate | None:
    """The certified interval of the optimum; None unless the agent has a limited view."""
    found = results["evaluation"]
    if "certified_lower" not in found:
        return None
    interval = (found["certified_lower"], found["certified_upper"])
    return Certificate(results["role"], found["discount"], *interval)


def provenance_parts(folder: Path, settings: AgentSettings, results: Plain) -> list[str]:
    """Settings, versions, machine and command."""
    plain = asdict(settings)
    parts = {
        f"{name.removesuffix('_settings')} settings": plain.pop(name)
        for name in ("task", "hyper", "curriculum_settings")
    }
    folded = {"settings of the run": plain} | parts
    made = made_with(read_json(folder / CONFIG).get("command", ""), results)
    return [made, *(details(name, pairs(found)) for name, found in folded.items() if found)]


def made_with(command: str, results: Plain) -> str:
    """The command of a run, its machine and versions, as a table."""
    facts = {
        name: ", ".join(f"{key} {value}" for key, value in results[name].items())
        for name in ("machine", "versions")
    }
    return pairs({"command": command} | facts)
