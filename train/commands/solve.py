"""`pursuit solve`: exact solutions.

Of a chase in a maze with its cop number and a figure; with --game of a small game, or exact best
responses in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

import scripted_agents
from pursuit.mazes.maze import Maze, load_maze
from pursuit.validation import check, choice, rule, text_of
from scripted_agents import games
from scripted_agents.exact.long_work import in_time
from scripted_agents.games.small_game import SmallGame, longest_play
from scripted_agents.names import GAME_DISCOUNT as DISCOUNT
from scripted_agents.names import UNIFORM
from train.commands.parse import options_in, parse
from train.commands.progress import ProgressLine
from train.files import Plain, check_new_files, write_json
from train.reports.figures import BLUE, FORMATS, ORANGE, draw_cells, pyplot, save
from train.reports.tables import in_lines
from train.settings.checks import RANDOM_MOVES, Settings, check_default

if TYPE_CHECKING:  # slow to import
    from matplotlib.axes import Axes

    from scripted_agents.exact.joint.results import JointNashConv
    from scripted_agents.games.solve import Values

WIDTH = 32
"""Of the names of results."""
METHODS = ("value-iteration", "double-oracle", "fictitious-play")
PLAYS = 1000
"""Iterations of fictitious play."""
SHOWN = (1, 3, 10, 30, 100, 300, PLAYS)
"""Those that are printed."""

SECONDS = rule(lambda value: 0.0 < value < inf, "give a finite number above 0")


@dataclass(frozen=True)
class SolveCommand(Settings):
    """Solve the chase in a maze exactly: value, mixed states, cop number, figure.

    With --game NAME a small game is solved: `pursuit solve --game NAME --help`.
    """

    maze: str = "5x5"
    """A shipped maze (2x2 ... 9x9, 15x15, also -tree and -open), or the path of a maze file."""
    method: Annotated[str, choice(*METHODS)] = METHODS[0]
    """value-iteration; or, with NashConv per iteration, double-oracle or fictitious-play."""
    discount: float = 0.95
    """Discount of each step, in (0, 1)."""
    horizon: int | None = None
    """Solve for this number of steps, without discount."""
    num_chasers: int = 1
    """Number of chasers, which act as one player. 2: for small mazes, without a figure."""
    stay_action: bool = False
    """Add a fifth action: stay."""
    move_order: str = "simultaneous"
    """simultaneous, or chasers_first."""
    chaser_cell: int | None = None
    """Cell of the chaser in the right figure; by default one with very different values."""
    evader_cell: int | None = None
    """Cell of the evader in the left figure; by default likewise."""
    view_radius: int | None = None
    """Bound the optimum of one agent with this observation radius in path steps, against A*."""
    role: Annotated[str, choice("chaser", "evader")] = "chaser"
    """The agent with the limited view: chaser or evader."""
    opponent_epsilon: Annotated[float, RANDOM_MOVES] = 0.2
    """Probability of random moves of its A* opponent."""
    seconds: Annotated[float, SECONDS] = 20.0
    """Time limit of the search with --view-radius."""
    out: Path | None = None
    """The figure (.png, .svg or .pdf); solve-MAZE.png by default."""
    overwrite: bool = False
    """Replace the figure if it exists."""


@dataclass(frozen=True)
class SolveGameCommand(Settings):
    """Solve a small game exactly: its states, and for two players with opposite rewards its value
    and an equilibrium; for other games best responses to uniform play and its NashConv."""

    game: str
    """Name of the game: a shipped one such as soccer or goofspiel(cards=4), openspiel:NAME(...), or
    package.module:Name(size=4) of a class or function that returns a Game."""
    players: str | None = None
    """The best response of these players to uniform play of all others: a name, or several with
    commas, a,b, which act as one with the sum of their rewards."""
    discount: float | None = None
    """Discount of each step. None: 1 in a game that always ends and with --horizon, else 0.95."""
    horizon: int | None = None
    """Number of steps of an episode. None: without limit."""
    out: Path | None = None
    """Write values and policies of all states to this new .json file; with a horizon the policies
    are those of the first step."""
    overwrite: bool = False
    """Replace --out if it exists."""


def solve(arguments: Sequence[str]) -> None:
    """`pursuit solve`."""
    if "game" in options_in(arguments):
        solve_game(parse(SolveGameCommand, arguments, "solve"))
    else:
        solve_maze(parse(SolveCommand, arguments, "solve"))


# -- a chase in a maze -----------------------------------------------------------------------------

FIGURE = ("chaser_cell", "evader_cell", "out", "overwrite")
LIMITED_VIEW = ("role", "opponent_epsilon", "seconds")
"""Options of the figure, and of an agent with a limited view."""


def solve_maze(given: SolveCommand) -> None:
    """Print the solution of a chase, and draw it; ValueError for invalid options."""
    check_options(given)
    maze = load_maze(given.maze)
    check(
        not maze.exit_marks,
        f"maze={given.maze!r} has exits marked E, which `pursuit solve` does not take; see "
        "`pursuit baseline --task escape`",
    )
    check(
        given.move_order != "turns",
        "move_order='turns': `pursuit solve` takes simultaneous and chasers_first; see `pursuit "
        "baseline --move-order turns --stay-action`",
    )
    if given.view_radius is not None:
        print(describe_limited_view(maze, given))
        return
    if given.method != METHODS[0]:
        print(describe_population(maze, given))
        return
    cells = {"chaser_cell": given.chaser_cell, "evader_cell": given.evader_cell}
    for name, cell in cells.items():
        check(
            cell is None or 0 <= cell < maze.num_cells,
            f"{name}={cell}; give a cell of {maze.name}, 0 to {maze.num_cells - 1}",
        )
    check(
        given.num_chasers < maze.num_cells,
        f"num_chasers={given.num_chasers} with one evader, but {maze.name} has {maze.num_cells} "
        "cells; give fewer chasers or a larger maze",
    )
    out = given.out or Path(f"solve-{Path(given.maze).stem}.png")
    check(out.suffix[1:] in FORMATS, f"out={out}; give .png, .svg or .pdf")
    check_new_files([out], given.overwrite)
    began = perf_counter()
    order: Any = given.move_order
    how = (given.discount, given.stay_action, given.horizon, order, given.num_chasers)
    tell, solving = ProgressLine(), f"solving {maze.name}"
    solution = scripted_agents.solve_chase(maze, *how, lambda share: tell(solving, share))
    tell.close()
    print(describe(solution, perf_counter() - began))
    try:
        number = scripted_agents.cop_number(
            maze, report=lambda done, chasers: tell(f"{chasers} chaser(s), alternating", done)
        )
        text = "more than 3" if number is None else str(number)
    except ValueError as error:
        text = f"not known ({error})"
    tell.close()
    print(f"{'cop number (alternating moves)':<{WIDTH}}{text}")
    if given.num_chasers == 1:
        shown = zip(cells.values(), default_cells(solution), strict=True)
        chaser, evader = (own if cell is None else cell for cell, own in shown)
        draw_solution(out, solution, chaser, evader)
        print(f"figure: {out}")


def check_options(given: SolveCommand) -> None:
    """ValueError for invalid values, or options that have no effect with the others."""
    if given.view_radius is None:
        check_default(given, SolveCommand, LIMITED_VIEW, "it is an option of --view-radius")
        if given.horizon is not None:
            check_default(given, SolveCommand, ["discount"], "--horizon solves without discount")
    else:
        names = ("method", "num_chasers", "horizon", *FIGURE)
        why = "--view-radius solves for one chaser and one evader, discounted, without a figure"
        check_default(given, SolveCommand, names, why)
    if given.method != METHODS[0]:
        why = f"{given.method} solves for one chaser and one evader, discounted, without a figure"
        check_default(given, SolveCommand, ("num_chasers", "horizon", *FIGURE), why)
    if given.num_chasers > 1:
        check_default(given, SolveCommand, FIGURE, "the figure is for one chaser only")


def describe_limited_view(maze: Maze, given: SolveCommand) -> str:
    """The proven bounds of the optimum of an agent with a limited view, one per line."""
    own: Any = given.role
    form = scripted_agents.AStarEvader if own == "chaser" else scripted_agents.AStarChaser
    opponent = form(given.opponent_epsilon)
    table = opponent.action_probabilities(maze, given.stay_action)
    tell, name = ProgressLine(), f"radius {given.view_radius}"
    names = ("discount", "seconds", "role", "move_order")
    how: Plain = {option: getattr(given, option) for option in names}

    def report(now: float, lower: float, upper: float) -> None:
        tell(name, min(now / given.seconds, 1.0))

    full = scripted_agents.solve_hidden_chase(maze, table, None, **how)
    found = scripted_agents.solve_hidden_chase(maze, table, given.view_radius, report=report, **how)
    tell.close()
    low, up = (100.0 * (bound / full.upper - 1.0) for bound in (found.lower, found.upper))
    return in_lines(
        {
            "game": f"{maze.name}: the {own} sees {given.view_radius} path steps, against "
            f"{opponent!r}, {given.move_order}, discount {given.discount:g}",
            "optimum (mean over starts)": f"{found.lower:.4f} to {found.upper:.4f} steps, "
            f"discounted, proven ({100 * found.width:.3f} % wide)",
            "optimum with full view": f"{full.upper:.4f} steps, discounted",
            "above that with full view": f"{low:+.2f} to {up:+.2f} %",
            "solved in": f"{found.seconds:.1f} s",
        },
        WIDTH,
    )


def describe_population(maze: Maze, given: SolveCommand) -> str:
    """The iterations of double oracle or of fictitious play, and the result, one per line."""
    order: Any = given.move_order
    began, lines = perf_counter(), {}
    how = (given.discount, given.stay_action, order)
    tell, solving = ProgressLine(), f"solving {maze.name}"
    if given.method == "double-oracle":
        solved = scripted_agents.double_oracle(
            maze, *how, report=lambda one: tell(solving, nan, f"NashConv {one.nash_conv:.2g}")
        )
        for number, one in enumerate(solved.iterations, 1):
            lines[f"iteration {number}"] = (
                f"NashConv {one.nash_conv:.6f}; actions per state: chaser "
                f"{one.chaser_actions:.2f}, evader {one.evader_actions:.2f}"
            )
        value, conv = scripted_agents.mean_over_starts(solved.solution.values, maze), one.nash_conv
    else:
        played = scripted_agents.fictitious_play(
            maze, PLAYS, *how, lambda n, _: tell(solving, n / PLAYS)
        )
        for number in SHOWN:
            lines[f"iteration {number}"] = f"NashConv {played.nash_convs[number - 1]:.6f}"
        tables = played.chaser_policy, played.evader_policy
        met = scripted_agents.evaluate_exactly(maze, *tables, None, given.discount, order)
        value, conv = scripted_agents.mean_over_starts(met, maze), played.nash_convs[-1]
    tell.close()
    stay = "with" if given.stay_action else "no"
    text = {
        "maze": size_in_words(maze),
        "game": f"1 chaser, 1 evader, {order}, {stay} stay, discount {given.discount:g}",
        **lines,
        "value (mean over starts)": f"{value:.6f} steps, discounted; error at most "
        f"{max(conv, 1e-6):.2g}",
        "solved in": f"{perf_counter() - began:.2f} s by {given.method}",
    }
    return in_lines(text, WIDTH)


def size_in_words(maze: Maze) -> str:
    """The name and size of a maze."""
    loops = f"{maze.num_loops} loop{'' if maze.num_loops == 1 else 's'}"
    return f"{maze.name}: {maze.num_cells} cells, {loops}"


def describe(solution: scripted_agents.ChaseSolution, seconds: float) -> str:
    """The properties of a solution, one per line."""
    values, chasers, horizon = solution.values, solution.num_chasers, solution.horizon
    cells = np.indices(values.shape)
    apart = (cells[:-1] != cells[-1]).all(axis=0)
    states, mixed = int(apart.sum()), int(solution.mixed[apart].sum())
    if horizon is None:
        most, how = 1.0 / (1.0 - solution.discount), f"discount {solution.discount:g}"
        unit, never = "steps, discounted", f"{most:g} if never caught, 1 / (1 - discount)"
    else:
        most, how = float(horizon), f"horizon {horizon}"
        unit, never = "steps", f"{most:g} if never caught"
    escapes = int((values[apart] >= most * (1.0 - 1e-9)).sum())
    text = {
        "maze": size_in_words(solution.maze),
        "game": f"{chasers} chaser{'s' if chasers > 1 else ''}, 1 evader, {solution.move_order}, "
        f"{'with' if solution.stay_action else 'no'} stay, {how}",
        "value (mean over starts)": f"{solution.mean_over_starts:.6f} {unit}; {never}",
        "never caught from": f"{escapes:,} of {states:,} states",
        "optimal policies are random in": f"{mixed:,} of {states:,} states "
        f"(in the other {states - mixed:,} one action is optimal for each side)",
        "solved in": f"{seconds:.2f} s, {solution.sweeps} updates of all states",
    }
    return in_lines(text, WIDTH)


def default_cells(solution: scripted_agents.ChaseSolution) -> tuple[int, int]:
    """The chaser and evader cells with the largest standard deviation of values."""
    values = np.where(np.eye(len(solution.values), dtype=bool), np.nan, solution.values)
    return int(np.nanstd(values, axis=1).argmax()), int(np.nanstd(values, axis=0).argmax())


def draw_solution(
    path: Path, solution: scripted_agents.ChaseSolution, chaser: int, evader: int
) -> None:
    """Values as colours and policies as arrows, for a fixed cell of the other side."""
    maze = solution.maze
    side = min(7.0, 1.5 + 0.45 * max(maze.picture_size))
    size = (2 * side + 1.2, side + 0.7)
    figure, axes = pyplot().subplots(1, 2, figsize=size, layout="constrained")
    sides = (
        (axes[0], solution.values[:, evader], solution.chaser_policy[:, evader], evader, "evader"),
        (axes[1], solution.values[chaser], solution.evader_policy[:, chaser], chaser, "chaser"),
    )
    apart = ~np.eye(maze.num_cells, dtype=bool)
    low, high = solution.values[apart].min(), solution.values[apart].max()
    colors = {"cmap": "viridis", "vmin": low, "vmax": max(high, low + 1e-9), "alpha": 0.85}
    for axis, values, policy, other, name in sides:
        mover = "chaser" if name == "evader" else "evader"
        title = f"optimal {mover}, with the {name} at ●"
        shown = np.where(np.arange(maze.num_cells) == other, np.nan, values)
        image = draw_cells(axis, maze, shown, title, **colors)
        _draw_arrows(axis, maze, policy, other)
        color = ORANGE if name == "chaser" else BLUE
        axis.plot(*maze.picture[other, ::-1], "o", ms=11, color=color)
    unit = "steps" if solution.horizon is not None else f"steps, discount {solution.discount:g}"
    figure.colorbar(image, ax=axes, shrink=0.8, label=f"value ({unit})")
    figure.suptitle(f"{maze.name}: exact solution, {solution.move_order}", fontsize=11)
    save(figure, path)


def _draw_arrows(axis: Axes, maze: Maze, policy: NDArray[np.float64], other: int) -> None:
    """Arrows for actions, with lengths by their probability; a square for staying."""
    color = "white" if maze.is_grid else "black"  # on coloured squares, or on paper
    arrow = {"arrowstyle": "-|>", "color": color, "lw": 1.4}
    for cell in range(maze.num_cells):
        if cell == other:
            continue
        still = 0.0
        for action, chance in enumerate(policy[cell]):
            following = maze.neighbors[cell, action]
            if following == cell:
                still += chance
            elif chance > 0.02:
                x, y = maze.picture[cell, ::-1].tolist()
                dx, dy = (maze.picture[following, ::-1] - (x, y)).tolist()
                length = 0.12 + 0.3 * chance
                axis.annotate("", (x + dx * length, y + dy * length), (x, y), arrowprops=arrow)
        if still > 0.02:
            axis.plot(*maze.picture[cell, ::-1], "s", ms=2 + 4 * still, color=color)


# -- small games -----------------------------------------------------------------------------------


def solve_game(given: SolveGameCommand) -> None:
    """Print the solution, and write its tables; ValueError as `load_game`."""
    from scripted_agents.games.agents import uniform_table

    out = given.out
    check(out is None or out.suffix == ".json", f"out={out}; give a .json file")
    check_new_files([out], given.overwrite)
    began = perf_counter()
    game = games.load_game(given.game)
    enumerated, longest = perf_counter() - began, longest_play(game)
    team = given.players if given.players is None else tuple(given.players.split(","))
    for name in team or ():
        game.player(name)
    check(
        game.zero_sum or team is not None or out is None,
        f"out={out}: no equilibrium is computed for this kind of game; leave --out out, or give "
        "--players, whose best response is written then",
    )
    discount, horizon = given.discount, given.horizon
    if discount is None:
        discount = DISCOUNT if longest is None and horizon is None else 1.0
    if discount == 1.0 and horizon is None:
        horizon = longest
    how = "undiscounted" if discount == 1.0 else f"discounted by {discount:g} per step"
    limit = "" if horizon is None or horizon == longest else f", within {horizon} steps"
    ends = f"always end, after at most {longest or 0:,} steps"
    text = {
        "game": f"{given.game}: players {', '.join(game.players)}",
        "size": f"{game.num_states:,} states, {len(game.choices):,} joint actions",
        "enumerated in": f"{enumerated:.2f} s",
        "episodes": "can go on forever" if longest is None else ends,
        "returns": how + limit,
    }
    began = perf_counter()
    solution: games.SmallEquilibrium | games.SmallResponse | None = None
    uniform = {name: uniform_table(game, name) for name in game.players}
    if team is not None:
        others = {name: table for name, table in uniform.items() if name not in team}
        solution = games.respond(game, team, others, discount, horizon)
        returns = game.start @ games.returns_of(game, uniform, discount, horizon)
        found = described_response(game, solution, returns)
    elif game.zero_sum:
        tell = ProgressLine()
        solution = in_time(lambda: games.equilibrium(game, discount, horizon), None, tell)[0]
        tell.close()
        share = games.mixed_share(game, discount, horizon, solution)
        found = described_equilibrium(game, solution, share)
    else:
        found = described_gains(games.nash_conv(game, uniform, discount, horizon))
    print(in_lines({**text, **found, "solved in": f"{perf_counter() - began:.2f} s"}, WIDTH))
    if out is not None and solution is not None:
        named: Plain = {"game": given.game, "discount": discount, "horizon": horizon}
        write_json(out, named | tables_of(game, solution))
        print(f"values and policies: {out}")


def described_equilibrium(
    game: SmallGame, solution: games.SmallEquilibrium, visits: float
) -> dict[str, str]:
    """The value of a zero-sum game of two, and where its equilibria are mixed: in how many states,
    and the share `visits` of `mixed_share`."""
    mixed = int(solution.mixed.sum())
    share = f"{mixed:,} of {game.num_states:,} states ({100 * mixed / game.num_states:.1f} %)"
    share += f", {100 * visits:.1f} % of visits"
    return {
        f"value for {game.players[0]}": f"{solution.mean:z.6f} (mean over starts)",
        "optimal policies are random in": share,
    }


def described_response(
    game: SmallGame, best: games.SmallResponse, returns: Values
) -> dict[str, str]:
    """The best response of a team to uniform play of all others, and what it gains."""
    team = best.players
    plays = returns[[game.player(name) for name in team]].sum()
    names, others = " + ".join(team), [name for name in game.players if name not in team]
    against = f", {', '.join(others)} {UNIFORM}" if others else ""
    return {
        f"best response of {names}": f"{best.mean:z.6f} (mean over starts{against})",
        f"{UNIFORM} play of {names}": f"{plays:z.6f}",
    }


def described_gains(found: JointNashConv) -> dict[str, str]:
    """Returns of uniform play, of the best response of each player to it, and its NashConv."""
    many = len(found.returns)
    kind = f"{many} players" if many != 2 else "rewards that do not add up to 0"
    return {
        "equilibrium": f"none is computed for this kind of game ({kind}); what follows is exact",
        **{
            f"return of {name}": f"{found.returns[name]:z.6f} in {UNIFORM} play, "
            f"{found.best[name]:z.6f} with the best response to it"
            for name in found.returns
        },
        f"NashConv of {UNIFORM} play": f"{found.nash_conv:z.6f}",
    }


def tables_of(game: SmallGame, solution: games.SmallEquilibrium | games.SmallResponse) -> Plain:
    """The values and policies of a solution, state after state, for a JSON file."""
    mixed = getattr(solution, "mixed", None)
    kind = "equilibrium" if mixed is not None else f"best response to {UNIFORM} play"
    rows: list[Plain] = [
        {"state": text_of(state), "value": value, "policies": {}}
        for state, value in zip(game.states, solution.values.tolist(), strict=True)
    ]
    for name, table in solution.policies.items():
        seat = game.player(name)
        pieces = np.split(table, game.offsets(seat)[1:-1])
        for row, actions, chances in zip(rows, game.actions[seat], pieces, strict=True):
            row["policies"][name] = dict(zip(map(str, actions), chances.tolist(), strict=True))
    for row, random in zip(rows, [] if mixed is None else mixed.tolist(), strict=False):
        row["mixed"] = random
    return {"kind": kind, "value": solution.mean, "states": rows}
