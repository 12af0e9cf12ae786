"""Compiled kernels of games as a whole: state numbers, transitions and sweeps.

A *state* is a number: which evaders are free (a *group*), which cells hold exits, if these are
drawn, and goals (a *set*), whose move it is in turns, and the cells of all free agents. Captured
evaders have no cell. States are numbered group after group, sets within them, and cells within
those, the last agent's fastest. Groups of fewer free evaders and sets
of fewer goals come first: a step leads to a state of the same set, or to one of a smaller number.

Transitions are those of `pursuit.rules.step.step`, and are stored for all states.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined, subroutine
from pursuit.rules import layout
from pursuit.rules.layout import (
    NUM_CELLS,
    Games,
    StepRules,
    Teams,
    World,
    stay_of,
)
from pursuit.rules.option_step import step_with_options
from pursuit.rules.starts import is_exit
from pursuit.rules.step import step
from pursuit.rules.turn import turn_of
from scripted_agents.exact.joint.layout import Numbering, Players, Quantities, Store, Workspace

# -- numbers ---------------------------------------------------------------------------------------


@inlined
def number_of(games: Games, game: int, teams: Teams, cells: int, numbering: Numbering) -> int:
    """The state of a game; -1 if it has ended."""
    mask, place = 0, np.int64(games.steps[game]) & (numbering.halves - 1)
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
    if numbering.exits.shape[0] > 1:
        exits = 0
        for number in range(numbering.exits.shape[1]):
            rank = 1
            for other in range(numbering.exits.shape[1]):
                rank += games.exit[game, other] < games.exit[game, number]
            exits += numbering.binomials[games.exit[game, number], rank]
        goals += exits * numbering.sets.shape[0]
    return int(numbering.offsets[group] + goals * numbering.sizes[group] + place)


@inlined
def write_state(
    games: Games, game: int, state: int, group: int, teams: Teams, cells: int, numbering: Numbering
) -> None:
    """Write a state into a game. Captured evaders are in the cell of the first chaser."""
    rest = state - numbering.offsets[group]
    goals = rest // numbering.sizes[group]
    rest -= goals * numbering.sizes[group]
    exits, goals = goals // numbering.sets.shape[0], goals % numbering.sets.shape[0]
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
    for number in range(numbering.exits.shape[1]):
        games.exit[game, number] = numbering.exits[exits, number]
    games.steps[game] = rest
    games.maze[game] = 0


@inlined
def can_be(games: Games, game: int, teams: Teams, always_captures: bool) -> bool:
    """Whether a state can occur between steps.

    No collector is on a goal, no evader on an exit and, if a shared cell is always a capture, no
    chaser on an evader.
    """
    for evader in layout.evaders_of(teams):
        if not games.active[game, evader]:
            continue
        for chaser in layout.chasers_of(teams):
            here = games.position[game, chaser] == games.position[game, evader]
            if here and always_captures:
                return False
        if is_exit(games.exit[game], games.position[game, evader], games.exit.shape[1]):
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
    games: Games, teams: Teams, cells: int, numbering: Numbering, first: int,
    always_captures: bool, real: Any,
) -> None:  # fmt: skip
    """Put the states from `first` on into games; `real` [games] bool: whether each can be."""
    group = 0
    for game in range(real.shape[0]):
        group = group_at(first + game, group, numbering)
        write_state(games, game, first + game, group, teams, cells, numbering)
        real[game] = can_be(games, game, teams, always_captures)


@compiled
def fill_numbers(
    games: Games, teams: Teams, cells: int, numbering: Numbering, numbers: Any
) -> None:
    """Fill `numbers` [games] with the states of games; -1 if they have ended."""
    for game in range(numbers.shape[0]):
        numbers[game] = number_of(games, game, teams, cells, numbering)


# -- one state -------------------------------------------------------------------------------------


@inlined
def restore_game(games: Games, rules: StepRules, work: Workspace, steps: Any) -> None:
    """The game as it was before the step."""
    for agent in layout.agents_of(rules.teams):
        games.position[0, agent] = work.cells[agent]
        games.active[0, agent] = work.active[agent]
    for goal in layout.goals_of(rules.teams):
        games.goal[0, goal] = work.goals[goal]
    games.steps[0] = steps


@inlined
def without_bumps(
    rules: StepRules, world: World, players: Players, player: int, work: Workspace, joint: int
) -> int:
    """A player's joint action with the first of the actions that run into a wall for all these, and
    action 0 for agents that have left the game."""
    found, scale = 0, 1
    for back in range(players.begins[player + 1] - players.begins[player]):
        seat = players.seats[players.begins[player + 1] - 1 - back]
        cell, action = work.cells[seat], joint % rules.num_actions
        joint //= rules.num_actions
        if not work.active[seat]:
            action = 0
        elif world.neighbors[cell, action] == cell:
            action = 0
            while world.neighbors[cell, action] != cell:
                action += 1
        found += scale * action
        scale *= rules.num_actions
    return found


@subroutine
def list_options(
    rules: StepRules, world: World, players: Players, state: int, steps: Any, work: Workspace
) -> None:
    """What every player may do: one that decides all that leads to different cells, of bumps the
    first; the others what they do with some chance; one that is not to move stays."""
    for player in range(players.begins.shape[0] - 1):
        first, last = players.begins[player], players.begins[player + 1]
        free: Any = 0
        many, waiting = 0, False
        for at in range(first, last):
            free |= work.active[players.seats[at]]
        if rules.options.turns:
            chases = players.seats[first] < rules.teams.chasers
            waiting = (steps & 1) == (1 if chases else 0)
            free &= np.int64(not waiting)
        work.keeps[player] = -1
        if not free:
            joint = 0
            for _ in range(first, last):
                joint = joint * rules.num_actions + (stay_of(world.neighbors) if waiting else 0)
            work.option[player, 0], work.chance[player, 0], many = joint, 1.0, 1
            work.keeps[player] = 0
        elif player < players.deciding:
            cell, stays = work.cells[players.seats[first]], -1
            for action in range(rules.num_actions):
                bumps = world.neighbors[cell, action] == cell
                if not bumps or (stays < 0 and not players.moves_first):
                    if bumps:
                        work.keeps[player] = many
                    work.option[player, many], work.chance[player, many] = action, 1.0
                    many += 1
                if bumps and stays < 0:
                    stays = action
            if stays >= 0 and players.moves_first:
                work.keeps[player] = many
                work.option[player, many], work.chance[player, many] = stays, 1.0
                many += 1
        else:
            row = np.int64(players.codes[player - players.deciding, state])
            for joint in range(rules.num_actions ** (last - first)):
                chance = players.rows[row + joint]
                if chance == 0.0:
                    continue
                option, at = without_bumps(rules, world, players, player, work, joint), many
                for earlier in range(many):
                    if work.option[player, earlier] == option:
                        at = earlier
                if at == many:
                    work.option[player, many], work.chance[player, many] = option, 0.0
                    many += 1
                work.chance[player, at] += chance
        work.many[player] = many


@inlined
def write_actions(players: Players, work: Workspace, first: int, last: int, actions: int) -> float:
    """Write the actions of these players in the options that they pick; the chance of the picks."""
    chance = 1.0
    for back in range(last - first):
        player = last - 1 - back
        option = work.pick[player]
        joint, seat = work.option[player, option], players.begins[player + 1] - 1
        while seat > players.begins[player]:
            work.actions[0, players.seats[seat]] = joint % actions
            joint //= actions
            seat -= 1
        work.actions[0, players.seats[seat]] = joint
        chance *= work.chance[player, option]
    return chance


@inlined
def pick_next(work: Workspace, first: int, last: int) -> None:
    """The next combination of options of these players, the last one's counting fastest."""
    for back in range(last - first):
        player = last - 1 - back
        work.pick[player] += 1
        if work.pick[player] < work.many[player]:
            return
        work.pick[player] = 0


def expand_by(step_once: Any) -> Any:
    """The expansion of a state by `step` or, for rules with options, by `step_with_options`."""

    @inlined
    def expand(
        games: Games, goals: Any, rules: StepRules, world: World, memory: layout.Memory,
        scratch: Any, numbering: Numbering, players: Players, quantities: Quantities,
        work: Workspace, store: Store, state: int,
    ) -> None:  # fmt: skip
        """Store the transitions of the current state of the game.

        Moves do not slip here; see `sweep`.
        """
        agents, number = players.seats.shape[0], work.best.shape[0]
        cells = int(world.mazes[NUM_CELLS, 0])
        steps = np.int64(games.steps[0])
        new_round = not rules.options.turns or (steps & 1) == 0
        for agent in layout.agents_of(rules.teams):
            work.cells[agent] = games.position[0, agent]
            work.active[agent] = games.active[0, agent]
        for goal in layout.goals_of(rules.teams):
            work.goals[goal] = games.goal[0, goal]
        list_options(rules, world, players, state, steps, work)
        ours, theirs, all_players = 1, 1, players.begins.shape[0] - 1
        for player in range(all_players):
            work.pick[player] = 0
            if player < players.deciding:
                ours *= work.many[player]
            else:
                theirs *= work.many[player]
        store.shape[state, 0], store.shape[state, 1] = ours, theirs
        store.shape[state, 2] = work.many[0]
        store.shape[state, 3] = not rules.options.turns or not new_round
        for player in range(store.slips.shape[0]):
            store.axes[state, player, 0] = work.many[player]
            store.axes[state, player, 1] = work.keeps[player]
        pair, edge = store.pairs[state], store.edges[state]
        turn = turn_of(memory, 0, rules, world, scratch)
        for own in range(ours):
            write_actions(players, work, 0, players.deciding, rules.num_actions)
            pick_next(work, 0, players.deciding)
            joint = 0
            for seat in range(players.deciding):
                joint = joint * rules.num_actions + work.actions[0, players.seats[seat]]
            store.joints[edge + own] = joint
            for q in range(number):
                lasts = 0
                for agent in range(agents):
                    lasts |= quantities.lasting[q, agent] & work.active[agent]
                store.sides[edge + own * number + q] = lasts if new_round else 0
            for other in range(theirs):
                chance = write_actions(
                    players, work, players.deciding, all_players, rules.num_actions
                )
                pick_next(work, players.deciding, all_players)
                restore_game(games, rules, work, steps)
                end = step_once(turn, goals, work.actions[0], memory.streams[0], memory.rewards[0])
                ended = end == layout.TERMINATED
                following = int(np.int64(-1))
                if not ended:
                    following = number_of(games, 0, rules.teams, cells, numbering)
                store.following[pair + own * theirs + other] = following
                store.sides[edge + ours * number + other] = chance
                for q in range(number):
                    worth = quantities.ending[q] if ended else 0.0
                    for agent in range(agents):
                        worth += quantities.reward_weights[q, agent] * memory.rewards[0, agent]
                    store.sides[edge + own * number + q] += chance * worth

    return expand


expand_plainly, expand_with_options = expand_by(step), expand_by(step_with_options)


@inlined
def options_without_slips(numbers: Any) -> layout.Options:
    """`layout.options_of`, without slips."""
    options = layout.options_of(numbers)
    return layout.Options(
        options.capture, options.n_catch, options.recheck, options.block, options.turns, False,
        options.touches, options.exits,
    )  # fmt: skip


def entry_for(duel: bool, has_goals: bool, plain: bool) -> Any:
    """The kernel that fills a store: of duels, of games with or without goals, and without options
    of the rules (`plain`) or with any. Teams that the compiler knows halve its time."""

    @compiled
    def fill_store(
        memory: layout.Memory, numbers: Any, coefficients: Any, world: World, scratch: Any,
        numbering: Numbering, players: Players, quantities: Quantities, work: Workspace,
        store: Store, first: int, last: int,
    ) -> None:  # fmt: skip
        """Store what follows the states from `first` to `last` - 1 that the store has room for."""
        teams = Teams(1, 1, 0, 0) if duel else layout.teams_of(numbers)
        options = layout.PLAIN if plain else options_without_slips(numbers)
        games = layout.games_of(memory)
        # Conditions on constants: only one side is compiled.
        goals = memory.goals[0, layout.GOAL] if has_goals else None
        rules = layout.step_rules_of(teams, numbers, coefficients, options)
        group = 0
        for state in range(first, last):
            if store.pairs[state + 1] == store.pairs[state]:
                continue
            group = group_at(state, group, numbering)
            write_state(games, 0, state, group, teams, int(world.mazes[NUM_CELLS, 0]), numbering)
            if plain:
                expand_plainly(
                    games, goals, rules, world, memory, scratch, numbering, players, quantities,
                    work, store, state,
                )  # fmt: skip
            else:
                expand_with_options(
                    games, goals, rules, world, memory, scratch, numbering, players, quantities,
                    work, store, state,
                )  # fmt: skip

    return fill_store


DUEL = (True, False, True)
FILL_STORE = {DUEL: entry_for(*DUEL)} | {
    (False, has_goals, plain): entry_for(False, has_goals, plain)
    for has_goals in (False, True)
    for plain in (False, True)
}
"""By whether games are plain duels, whether they have goals, and whether they are plain."""
