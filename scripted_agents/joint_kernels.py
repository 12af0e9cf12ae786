"""Compiled kernels of games as a whole: numbers for all that can stand in a game, and sweeps.

A *state* is a number: who is still free (a *group*), which cells hold goals (a *set*), and the
cells of all free agents. Captured evaders have no cell. States are numbered group after group, sets
within them, and cells within those, the last agent's fastest. Groups of fewer free evaders and sets
of fewer goals come first: a step leads to a state of the same set, or to one of a smaller number.

Transitions are those of `pursuit.rules.step.step`, taken anew at every visit: none is stored.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compiled import compiled, inlined, subroutine
from pursuit.rules import layout
from pursuit.rules.layout import Games, Outcome, Plan, Rules, Teams, World
from pursuit.rules.step import step

TIE = 1e-12
"""Difference, relative to the value, below which two actions count as equally good."""

MOST_ACTIONS = 5


class Numbering(NamedTuple):
    """How states are numbered; see `scripted_agents.joint_states.JointStates`."""

    masks: Any
    offsets: Any
    sizes: Any
    group_of: Any
    sets: Any
    binomials: Any
    bases: Any


class Players(NamedTuple):
    """Who decides, and what the others do.

    order: [agents] int64, the seats, those that decide first.
    deciding: how many those are.
    codes: [other seats, states] uint32, which row a seat plays in a state; in the order of `order`.
    rows: [rows, actions] float64, distributions.
    """

    order: Any
    deciding: int
    codes: Any
    rows: Any


class Quantities(NamedTuple):
    """What is summed up along a game; Q quantities, of which the first is decided by.

    paid: [Q, agents] float64, how much of each agent's reward counts.
    lasting: [Q, agents] int64, 1: a step counts 1 as long as any of these is free.
    ending: [Q] float64, what the end of the game counts.
    """

    paid: Any
    lasting: Any
    ending: Any


class Store(NamedTuple):
    """What follows each state, kept so that later sweeps need not step; filled where `filling`.

    A state with `shape` (ours, theirs) of joint actions has room in `following` from `pairs` on and
    in `sides` and `joints` from `edges` on: the next state of each pair, -1 for the end; what ours
    are worth at once, [ours, Q]; the chances of theirs.

    pairs, edges: [states + 1] int64; shape: [states, 2] uint8; following: int32; sides: float64;
    joints: int16.
    """

    filling: bool
    pairs: Any
    edges: Any
    shape: Any
    following: Any
    sides: Any
    joints: Any


class Room(NamedTuple):
    """Room for one state at a time: what stands in it, and what everybody may do.

    cells, active: [agents] int64; goals: [goals] int64; actions: [1, agents] int32.
    option: [agents, MOST_ACTIONS] int64, actions that lead to different cells; `many` [agents] of
    them, with their `chance` [agents, MOST_ACTIONS]. sums, best: [Q] float64.
    """

    cells: Any
    active: Any
    goals: Any
    actions: Any
    option: Any
    many: Any
    chance: Any
    sums: Any
    best: Any


# -- numbers ---------------------------------------------------------------------------------------


@inlined
def number_of(games: Games, game: int, teams: Teams, cells: int, numbering: Numbering) -> int:
    """The number of what stands in a game; -1 where it is over."""
    mask, place = 0, 0
    for chaser in layout.chasers_of(teams):
        place = place * cells + games.position[game, chaser]
    for evader in layout.evaders_of(teams):
        if games.active[game, evader]:
            mask |= 1 << (evader - teams.chasers)
            place = place * cells + games.position[game, evader]
    for runner in layout.runners_of(teams):
        place = place * cells + games.position[game, runner]
    group = numbering.group_of[mask]
    if group < 0:
        return -1
    goals = 0
    if teams.goals > 0:
        left = 0
        for goal in layout.goals_of(teams):
            cell = games.goal[game, goal]
            if cell >= 0:
                rank = 1
                for other in layout.goals_of(teams):
                    rank += (games.goal[game, other] >= 0) & (games.goal[game, other] < cell)
                goals += numbering.binomials[cell, rank]
                left += 1
        if left == 0:
            return -1
        goals += numbering.bases[left]
    return int(numbering.offsets[group] + goals * numbering.sizes[group] + place)


@inlined
def put(
    games: Games, game: int, state: int, group: int, teams: Teams, cells: int, numbering: Numbering
) -> None:
    """Put a state into a game. Captured evaders stand where the first chaser does."""
    rest = state - numbering.offsets[group]
    goals = rest // numbering.sizes[group]
    rest -= goals * numbering.sizes[group]
    mask = numbering.masks[group]
    for at in range(teams.chasers + teams.evaders + teams.runners):
        agent = teams.chasers + teams.evaders + teams.runners - 1 - at
        evader = agent - teams.chasers
        free = 1
        if 0 <= evader < teams.evaders:
            free = mask >> evader & 1
        games.active[game, agent] = free
        if free:
            games.position[game, agent] = rest % cells
            rest //= cells
    for evader in layout.evaders_of(teams):
        if not games.active[game, evader]:
            games.position[game, evader] = games.position[game, 0]
    for goal in layout.goals_of(teams):
        games.goal[game, goal] = numbering.sets[goals, goal]
    games.steps[game] = 0
    games.maze[game] = 0


@inlined
def can_be(games: Games, game: int, teams: Teams) -> bool:
    """Whether a state can stand between two steps: nobody is about to be caught, or on a goal."""
    for evader in layout.evaders_of(teams):
        for chaser in layout.chasers_of(teams):
            here = games.position[game, chaser] == games.position[game, evader]
            if here and games.active[game, evader]:
                return False
    for goal in layout.goals_of(teams):
        cell = games.goal[game, goal]
        for agent in layout.collectors_of(teams):
            if cell >= 0 and games.active[game, agent] and games.position[game, agent] == cell:
                return False
    return True


@inlined
def group_at(state: int, group: int, numbering: Numbering) -> int:
    """The group of a state that is not in an earlier one than `group`."""
    while state >= numbering.offsets[group + 1]:
        group += 1
    return group


@compiled
def fill_games(
    position: Any, active: Any, event: Any, goal: Any, steps: Any, maze: Any, counts: Any,
    cells: int, masks: Any, offsets: Any, sizes: Any, group_of: Any, sets: Any, binomials: Any,
    bases: Any, first: int, real: Any,
) -> None:  # fmt: skip
    """Put the states from `first` on into games; `real` [games] bool: whether each can be."""
    games = Games(position, active, event, goal, steps, maze)
    numbering = Numbering(masks, offsets, sizes, group_of, sets, binomials, bases)
    teams, group = Teams(counts[0], counts[1], counts[2], counts[3]), 0
    for game in range(real.shape[0]):
        group = group_at(first + game, group, numbering)
        put(games, game, first + game, group, teams, cells, numbering)
        real[game] = can_be(games, game, teams)


# -- one state -------------------------------------------------------------------------------------


@inlined
def put_back(games: Games, rules: Rules, room: Room) -> None:
    """The game as it was before the step."""
    for agent in layout.agents_of(rules.teams):
        games.position[0, agent] = room.cells[agent]
        games.active[0, agent] = room.active[agent]
    for goal in layout.goals_of(rules.teams):
        games.goal[0, goal] = room.goals[goal]
    games.steps[0] = 0


@subroutine
def list_options(rules: Rules, world: World, players: Players, state: int, room: Room) -> None:
    """What everybody may do: for those who decide moves before standing still, of bumps the first;
    for the others what they do with some chance, all bumps together."""
    for at in range(players.order.shape[0]):
        seat, many = players.order[at], 0
        cell = np.int64(room.cells[seat])
        if not room.active[seat]:
            room.option[seat, 0], room.chance[seat, 0], room.many[seat] = 0, 1.0, 1
            continue
        stays, chance_of_staying = -1, 0.0
        row = np.int64(0)
        if at >= players.deciding:
            row = np.int64(players.codes[at - players.deciding, state])
        for action in range(rules.num_actions):
            chance = 1.0
            if at >= players.deciding:
                chance = players.rows[row, action]
            if chance == 0.0:
                continue
            if world.neighbors[cell, action] == cell:
                chance_of_staying += chance
                if stays < 0:
                    stays = action
            else:
                room.option[seat, many], room.chance[seat, many] = action, chance
                many += 1
        if stays >= 0:
            room.option[seat, many], room.chance[seat, many] = stays, chance_of_staying
            many += 1
        room.many[seat] = many


@inlined
def back_up(
    games: Games, rules: Rules, world: World, plan: Plan, outcome: Outcome, numbering: Numbering,
    players: Players, quantities: Quantities, room: Room, store: Store, state: int, values: Any,
    sign: float, discount: float,
) -> int:  # fmt: skip
    """Fill `room.best` with what a state is worth by what follows it; the joint action chosen."""
    teams, deciding = rules.teams, players.deciding
    agents, cells = players.order.shape[0], int(world.num_cells[0])
    for agent in layout.agents_of(teams):
        room.cells[agent] = games.position[0, agent]
        room.active[agent] = games.active[0, agent]
    for goal in layout.goals_of(teams):
        room.goals[goal] = games.goal[0, goal]
    list_options(rules, world, players, state, room)
    ours, theirs = 1, 1
    for at in range(agents):
        if at < deciding:
            ours *= room.many[players.order[at]]
        else:
            theirs *= room.many[players.order[at]]
    chosen, bound, least, edge = 0, np.inf, np.inf, np.int64(0)
    if store.filling:
        edge = store.edges[state]
        store.shape[state, 0], store.shape[state, 1] = ours, theirs
        for own in range(ours * room.sums.shape[0]):
            store.sides[edge + own] = 0.0
    for own in range(ours):
        rest, joint, scale = own, 0, 1
        for back in range(deciding):
            seat = players.order[deciding - 1 - back]
            action = room.option[seat, rest % room.many[seat]]
            rest //= room.many[seat]
            room.actions[0, seat] = action
            joint += scale * action
            scale *= rules.num_actions
        for q in range(room.sums.shape[0]):
            room.sums[q] = 0.0
        for other in range(theirs):
            rest, chance = other, 1.0
            for back in range(agents - deciding):
                seat = players.order[agents - 1 - back]
                option = rest % room.many[seat]
                rest //= room.many[seat]
                room.actions[0, seat] = room.option[seat, option]
                chance *= room.chance[seat, option]
            put_back(games, rules, room)
            ended = step(games, 0, room.actions, rules, world, plan, outcome) == layout.TERMINATED
            following = int(np.int64(-1))
            if not ended:
                following = number_of(games, 0, teams, cells, numbering)
            for q in range(room.sums.shape[0]):
                worth = quantities.ending[q] if ended else 0.0
                for agent in range(agents):
                    worth += quantities.paid[q, agent] * outcome.rewards[0, agent]
                if store.filling:
                    store.sides[edge + own * room.sums.shape[0] + q] += chance * worth
                if not ended:
                    worth += discount * values[following, q]
                room.sums[q] += chance * worth
            if store.filling:
                store.following[store.pairs[state] + own * theirs + other] = following
                store.sides[edge + ours * room.sums.shape[0] + other] = chance
        if store.filling:
            store.joints[edge + own] = joint
        first = sign * room.sums[0]
        if first < bound:
            bound, chosen = first - TIE * max(1.0, abs(first)), joint
        if first < least or own == 0:
            least = first
            for q in range(room.sums.shape[0]):
                room.best[q] = room.sums[q]
    for q in range(room.sums.shape[0]):
        lasts = 0
        for agent in range(agents):
            lasts |= quantities.lasting[q, agent] & room.active[agent]
        room.best[q] += lasts
        if store.filling:
            for own in range(ours):
                store.sides[edge + own * room.sums.shape[0] + q] += lasts
    return chosen


# -- sweeps ----------------------------------------------------------------------------------------


@compiled
def sweep(
    agents: Any, goals: Any, clocks: Any, coming: Any, reals: Any, flags: Any, rewards: Any,
    streams: Any, numbers: Any, pay: Any, mazes: Any, neighbors: Any, facts: Any, tables: Any,
    scratch: Any, masks: Any, offsets: Any, sizes: Any, group_of: Any, sets: Any, binomials: Any,
    bases: Any, order: Any, deciding: int, codes: Any, rows: Any, paid: Any, lasting: Any,
    ending: Any, cells_: Any, active: Any, goals_: Any, actions: Any, option: Any, many: Any,
    chance: Any, sums: Any, best: Any, sign: float, discount: float, only_whether: bool,
    filling: bool, pairs: Any, edges: Any, shape: Any, following: Any, sides: Any, joints: Any,
    values: Any, target: Any, choice: Any, segments: Any, changes: Any,
) -> None:  # fmt: skip
    """Back up all states of `segments` [n, 2] (first state, and the one after the last) once.

    `target` may be `values`. `only_whether` makes 1 of all that is above 0. `choice` [states] gets
    the joint actions; `changes` [n, 2] the largest change of each segment, and the largest value.
    """
    memory = layout.Memory(agents, goals, clocks, coming, reals, flags, rewards, streams)
    games, rules = layout.games_of(memory), layout.rules_of(layout.teams_of(numbers), numbers, pay)
    world = layout.world_of(mazes, neighbors, facts, tables)
    numbering = Numbering(masks, offsets, sizes, group_of, sets, binomials, bases)
    room = Room(cells_, active, goals_, actions, option, many, chance, sums, best)
    players, quantities = Players(order, deciding, codes, rows), Quantities(paid, lasting, ending)
    store = Store(filling, pairs, edges, shape, following, sides, joints)
    outcome, plan = layout.outcome_of(memory), layout.plan_of(scratch)
    cells = int(world.num_cells[0])
    for segment in range(segments.shape[0]):
        group, change, largest = 0, 0.0, 0.0
        for state in range(segments[segment, 0], segments[segment, 1]):
            group = group_at(state, group, numbering)
            put(games, 0, state, group, rules.teams, cells, numbering)
            if not can_be(games, 0, rules.teams):
                continue
            choice[state] = back_up(
                games, rules, world, plan, outcome, numbering, players, quantities, room, store,
                state, values, sign, discount,
            )  # fmt: skip
            for q in range(best.shape[0]):
                worth = best[q]
                if only_whether:
                    worth = 1.0 if worth > 0.0 else 0.0
                change = max(change, abs(worth - values[state, q]))
                largest = max(largest, abs(worth))
                target[state, q] = worth
        changes[segment, 0], changes[segment, 1] = change, largest
