"""A PettingZoo environment as a game that is enumerated and solved."""

from pursuit import chase_v0
from scripted_agents.games import ParallelGame, enumerate_game, equilibrium

env = chase_v0.parallel_env(maze="3x3", rewards="zero_sum", max_steps=10**6)


def save(env):
    return tuple(env.simulator.positions[0].tolist())


def restore(env, state):
    env.reset(options={"positions": list(state)})


game = enumerate_game(ParallelGame(env, save, restore, seeds=range(40)))
print(game.num_states, equilibrium(game).mean)
