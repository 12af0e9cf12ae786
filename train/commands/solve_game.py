"""`pursuit solve --game NAME`: the exact solution of a small game, or exact best responses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from pursuit.validation import check, text_of
from scripted_agents.exact.joint.results import JointNashConv
from scripted_agents.games.agents import DISCOUNT, UNIFORM, uniform_table
from scripted_agents.games.episodes import longest_play
from scripted_agents.games.mixing import mixed_share
from scripted_agents.games.named import load_game
from scripted_agents.games.small_game import SmallGame
from scripted_agents.games.solve import (
    SmallEquilibrium,
    SmallResponse,
    Values,
    equilibrium,
    nash_conv,
    respond,
    returns_of,
)
from train.files import Plain, check_new_files, write_json
from train.reports.tables import in_lines
from train.settings.checks import Settings

WIDTH = 32
"""Of the names of results."""


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


def solve_game(given: SolveGameCommand) -> None:
    """Print the solution, and write its tables; ValueError as `load_game`."""
    out = given.out
    check(out is None or out.suffix == ".json", f"out={out}; give a .json file")
    check_new_files([out], given.overwrite)
    began = perf_counter()
    game = load_game(given.game)
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
    solution: SmallEquilibrium | SmallResponse | None = None
    uniform = {name: uniform_table(game, name) for name in game.players}
    if team is not None:
        others = {name: table for name, table in uniform.items() if name not in team}
        solution = respond(game, team, others, discount, horizon)
        returns = game.start @ returns_of(game, uniform, discount, horizon)
        found = described_response(game, solution, returns)
    elif game.zero_sum:
        solution = equilibrium(game, discount, horizon)
        share = mixed_share(game, discount, horizon, solution)
        found = described_equilibrium(game, solution, share)
    else:
        found = described_gains(nash_conv(game, uniform, discount, horizon))
    print(in_lines({**text, **found, "solved in": f"{perf_counter() - began:.2f} s"}, WIDTH))
    if out is not None and solution is not None:
        named: Plain = {"game": given.game, "discount": discount, "horizon": horizon}
        write_json(out, named | tables_of(game, solution))
        print(f"values and policies: {out}")


def described_equilibrium(
    game: SmallGame, solution: SmallEquilibrium, visits: float
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


def described_response(game: SmallGame, best: SmallResponse, returns: Values) -> dict[str, str]:
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


def tables_of(game: SmallGame, solution: SmallEquilibrium | SmallResponse) -> Plain:
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
