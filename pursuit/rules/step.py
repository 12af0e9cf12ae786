"""The rules of one step of one game: step, ended.

For starts see `starts`, for observations `pursuit.observations.observations`.

All decisions use the state before the step; the new state is written last. Of the values written,
only events and rewards are read again. Loops over `chasers_of(teams)` and the like are unrolled in
kernels with constant team sizes.

                  before      decided (in `plan`)     written
    position      POSITION    AFTER                   POSITION
    captures                  CAPTORS, CAUGHT          ACTIVE, EVENT
    goals         GOAL        TAKERS                  GOAL, EVENT

`step` has no options; `option_step` decides on moves and captures with them. `settle` ends both.
"""

from __future__ import annotations

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Ints, Words
from pursuit.rules.layout import (
    ACTIVE,
    AFTER,
    CAPTORS,
    CAUGHT,
    COLLECTED_GOALS,
    GOING_ON,
    POSITION,
    RETURNS,
    STEPS,
    TAKERS,
    TERMINATED,
    TRUNCATED,
    agents_of,
    bit_of,
    chasers_of,
    collectors_of,
    evaders_of,
    goals_of,
    runners_of,
    stay_of,
)
from pursuit.rules.step_rewards import (
    Earned,
    add_capture_rewards,
    add_escape_rewards,
    add_goal_rewards,
    add_per_evader_rewards,
    add_step_rewards,
    add_touch_rewards,
)
from pursuit.rules.turn import (
    Goals,
    Turn,
    destination,
    is_free,
    may_collect,
    meets_evader,
)


@inlined
def step(turn: Turn, goals: Goals, actions: Ints, streams: Words, rewards: Earned) -> int:
    """Step one game; return GOING_ON, TERMINATED or TRUNCATED.

    `actions`, `streams` and `rewards`, which are written, are those of the game; nothing is drawn.
    """
    teams, plan, stay = turn.rules.teams, turn.plan, stay_of(turn.neighbors)
    for chaser in chasers_of(teams):
        plan[AFTER, chaser] = destination(turn, chaser, actions[chaser])
    for evader in evaders_of(teams):
        # A captured agent stays; no branch, as the processor could not predict it.
        action = stay + (np.int64(actions[evader]) - stay) * is_free(turn.agents, evader)
        plan[AFTER, evader] = destination(turn, evader, action)
    for runner in runners_of(teams):
        plan[AFTER, runner] = destination(turn, runner, actions[runner])
    return settle(turn, goals, rewards, decide_captures(turn), None)


@inlined
def step_runners(turn: Turn, goals: Goals, actions: Ints, streams: Words, rewards: Earned) -> int:
    """As `step`, of a game without chasers and evaders."""
    for runner in runners_of(turn.rules.teams):
        turn.plan[AFTER, runner] = destination(turn, runner, actions[runner])
    return settle(turn, goals, rewards, None, None)


@inlined
def settle(
    turn: Turn, goals: Goals, rewards: Earned, num_captured: int | None, num_escaped: int | None
) -> int:
    """Collect goals, write rewards and the new state, given the decisions on moves, captures and
    escapes; return as `step`. Rules of captures are not compiled without evaders, where
    `num_captured` is None, and those of escapes and touches not without options (`num_escaped`)."""
    rules, plan = turn.rules, turn.plan
    teams, steps = rules.teams, turn.clocks[STEPS] + 1
    collected, goals_left = decide_goals(turn, goals)
    all_collected, gone = collected > 0 and goals_left == 0, 0
    if num_captured is not None:
        gone += num_captured
    if num_escaped is not None:
        gone += num_escaped
    end = ended(turn, gone, all_collected, steps)

    # A round of turns has two steps; its second one pays the step rewards.
    pays = not rules.options.turns or (steps & 1) == 0
    add_step_rewards(turn, goals, rewards, pays)
    if num_captured is not None and num_captured > 0:
        add_capture_rewards(turn, rewards, num_captured, end)
    if num_escaped is not None and num_escaped > 0:
        add_escape_rewards(turn, rewards, end)
    if num_captured is not None and rules.chaser.per_evader != 0.0:
        add_per_evader_rewards(turn, goals, rewards, pays)
    touches = rules.options.touches and (not rules.options.turns or (steps & 1) == 1)
    if num_escaped is not None and touches:
        add_touch_rewards(turn, rewards)
    if collected > 0:
        collect_goals(turn, goals, rewards, end)
    for agent in agents_of(teams):
        turn.agents[POSITION, agent] = plan[AFTER, agent]
        turn.reals[RETURNS, agent] += rewards[agent]
    if num_captured is not None:
        for i in range(num_captured):
            turn.agents[ACTIVE, plan[CAUGHT, i]] = 0
    if num_escaped is not None and num_escaped > 0:
        for evader in evaders_of(teams):
            if plan[CAPTORS, evader] < 0:
                turn.agents[ACTIVE, evader] = 0
    turn.clocks[STEPS] = steps
    return end


# -- decisions -------------------------------------------------------------------------------------


@inlined
def decide_captures(turn: Turn) -> int:
    """Count the captors of every evader and list the captured evaders; return their number.

    If the chasers move first, an evader that one of them reaches does not move. Exact checks are
    made only for evaders that may share a cell with a chaser according to the bits of cells.
    """
    teams, plan, position = turn.rules.teams, turn.plan, turn.agents[POSITION]
    reached = np.uint64(0)
    for chaser in chasers_of(teams):
        reached |= bit_of(plan[AFTER, chaser])
    asked = num_captured = 0
    for evader in evaders_of(teams):
        near = reached & (bit_of(position[evader]) | bit_of(plan[AFTER, evader]))
        plan[CAPTORS, evader] = 0
        plan[CAUGHT, asked] = evader
        asked += (near != 0) * is_free(turn.agents, evader)
    for i in range(asked):
        evader, captors = plan[CAUGHT, i], 0
        for chaser in chasers_of(teams):
            if turn.rules.chasers_first and plan[AFTER, chaser] == position[evader]:
                plan[AFTER, evader] = position[evader]
        for chaser in chasers_of(teams):
            captors += meets_evader(turn, chaser, evader)
        plan[CAPTORS, evader] = captors
        plan[CAUGHT, num_captured] = evader
        num_captured += captors > 0
    return num_captured


@inlined
def decide_goals(turn: Turn, goals: Goals) -> tuple[int, int]:
    """Count the agents on every goal; return the numbers of goals collected and left."""
    teams, plan = turn.rules.teams, turn.plan
    collected = left = 0
    if goals is None:
        return collected, left
    for goal in goals_of(teams):
        takers, cell = 0, goals[goal]
        if cell >= 0:
            for agent in collectors_of(teams):
                takers += (plan[AFTER, agent] == cell) & may_collect(turn, agent)
            collected += takers > 0
            left += takers == 0
        plan[TAKERS, goal] = takers
    return collected, left


@inlined
def ended(turn: Turn, num_gone: int, all_collected: bool, steps: int) -> int:
    """TERMINATED if no evader or no goal is left; else TRUNCATED after the last step.

    `num_gone` evaders are captured or escape now.
    """
    free = -num_gone
    for evader in evaders_of(turn.rules.teams):
        free += is_free(turn.agents, evader)
    if all_collected or (turn.rules.teams.evaders > 0 and free == 0):
        return TERMINATED
    most = turn.rules.max_steps * (2 if turn.rules.options.turns else 1)
    return TRUNCATED if steps >= most else GOING_ON


@inlined
def collect_goals(turn: Turn, goals: Goals, rewards: Earned, end: int) -> None:
    """Write the rewards and events of the agents that collect goals, add the goals to those
    collected by each agent, shared ones in parts, and remove them."""
    if goals is None:
        return
    add_goal_rewards(turn, goals, rewards, end)
    plan = turn.plan
    for goal in goals_of(turn.rules.teams):
        if plan[TAKERS, goal] > 0:
            for agent in collectors_of(turn.rules.teams):
                if plan[AFTER, agent] == goals[goal] and may_collect(turn, agent):
                    turn.reals[COLLECTED_GOALS, agent] += 1.0 / plan[TAKERS, goal]
            goals[goal] = -1
