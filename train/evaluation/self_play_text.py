"""The results of self-play as sentences."""

from __future__ import annotations

from train.evaluation.diversity import describe_diversity
from train.evaluation.scores import OUTCOME
from train.evaluation.team_contest import describe_team
from train.files import Plain
from train.reports.curves import Series
from train.reports.figures import BLACK, BLUE, ORANGE
from train.settings.self_play import OPPOSING_ROLES

EXPLOITABILITY = {
    "nash_conv": Series((), "NashConv", BLACK, "-", 2.2),
    "chaser_exploitability": Series((), "of the chaser", ORANGE, "--", 1.3),
    "evader_exploitability": Series((), "of the evader", BLUE, "--", 1.3),
}
SCRIPTED_LINES = {
    "astar": ("A*", "-"),
    "random": ("random", ":"),
    "equilibrium": ("equilibrium", "--"),
}
AGAINST_SCRIPTED = {
    f"{role}_vs_{name}": Series((), f"{role} against {called}", color, style)
    for role, color in (("chaser", ORANGE), ("evader", BLUE))
    for name, (called, style) in SCRIPTED_LINES.items()
}


def describe_exploitability(results: Plain) -> list[str]:
    """The results as sentences: exact NashConv and value, and best responses."""
    found, start = results["evaluation"], results.get("at_start", {})
    limited = bool(results.get("limited_view"))
    met = results.get("matches", ())
    fixed = [each for each in OPPOSING_ROLES if any(row[each] == "frozen" for row in met)]
    meaning = "exact; 0 is an equilibrium"
    if fixed:
        part = found.get(f"{fixed[0]}_exploitability")
        shown = "" if part is None else f" {part:z.3f}"
        lost = f"exploitability{shown}, lost to a best response,"
        meaning = f"exact; {fixed[0]} fixed: its {lost} cannot fall"
    if limited:
        meaning = (
            "exact for best responses with full view, so an upper bound with a limited view, where "
            "equilibria can be above 0"
        )
    lines = []
    if "nash_conv" in found:
        before = f" (at the start {start['nash_conv']:.3f})" if "nash_conv" in start else ""
        unit = "discounted steps"
        if "outcome" in found:
            unit = f"{OUTCOME}, of best responses that may depend on time,"
        lines.append(f"NashConv {found['nash_conv']:z.3f} {unit}{before}; {meaning}.")
    if "not_exact" in results:
        lines.append(f"No exact NashConv: {results['not_exact']}.")
    for name, bounds in results.get("limited_best_responses", {}).items():
        what = f"Best response with the view of its role {name.replace('_', ' the ')}"
        what = "NashConv with these views" if name == "nash_conv" else what
        lines.append(f"{what}: {bounds[0]:.3f} to {bounds[1]:.3f} discounted steps, proven.")
    lines += describe_snapshots(results)
    if results.get("whole_game"):
        unit = OUTCOME if "outcome" in found else "discounted returns"
        lines.append(describe_whole_game(results["whole_game"], unit))
    if "game_value" in found and "value" in found:
        sight = " with full view" if limited else ""
        lines.append(
            f"Value of this pair of policies: {found['value']:.3f} discounted steps; of the game "
            f"at equilibrium{sight}: {found['game_value']:.3f}."
        )
        if found["game_value"] * (1.0 - results.get("discount", 1.0)) > 1.0 - 1e-9:
            lines.append(
                "The evader escapes from every start at equilibrium, so every chaser has "
                "exploitability 0."
            )
    for kind in ("exact", "approximate"):
        for name, steps in results.get(f"{kind}_best_response", {}).items():
            full = " with full view" if kind == "exact" and limited else ""
            against = name.replace("_", " the ")
            unit = OUTCOME if "outcome" in found else "steps"
            lines.append(f"{kind} best response{full} {against}: {steps:.2f} {unit}.".capitalize())
    for team in results.get("team", {}).values():
        lines += [f"{line[0].upper()}{line[1:]}." for line in describe_team(team)]
    return [*lines, *describe_time(results)]


def describe_time(results: Plain) -> list[str]:
    """The frames and seconds of a run as a sentence, if it is one."""
    if "frames" not in results:
        return []
    return [f"{results['frames']:,} frames in {results['seconds']:.1f} s."]


def describe_snapshots(results: Plain) -> list[str]:
    """NashConv of the mixture of snapshots, and their diversity, as sentences."""
    lines = []
    if "mixture_nash_conv" in results:
        bounds = "{:.3f} to {:.3f}".format(*results["mixture_nash_conv"])
        which = "all snapshots" if results["sampling"] == "uniform" else "the Nash mixture"
        lines.append(f"NashConv of drawing from {which} in each game: {bounds}, proven.")
    if results.get("diversity"):
        lines.append(f"{describe_diversity(results['diversity'])}.")
    return lines


def describe_whole_game(found: Plain, unit: str = "discounted returns") -> str:
    """NashConv in returns of this unit as a sentence."""
    each = ", ".join(
        f"return of the {role} {value:.3f}, a best response gains {found['gains'][role]:.3f}"
        for role, value in found["returns"].items()
    )
    return f"NashConv in {unit}: {found['nash_conv']:.3f} ({each}; exact, each side one player)."


def describe_mixing(share: float | None) -> list[str]:
    """A mixed share in sentences; none for None."""
    if share is None:
        return []
    if share == 0.0:
        return ["equilibrium: pure play is optimal in every state that it visits"]
    return [f"equilibrium: optimal play is random in {100.0 * share:.3g} % of its visits"]
