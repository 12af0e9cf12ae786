"""IPPO of AgileRL. It does not accept captured agents, which SuperSuit keeps in the game."""

# needs: agilerl
import supersuit
from agilerl.algorithms import IPPO

from pursuit import chase_v0


def make():
    game = chase_v0.parallel_env(maze="3x3", num_chasers=2, num_evaders=2, max_cycles=50)
    return supersuit.black_death_v3(game)


env, agents = make(), make().possible_agents
spaces = [env.observation_space(a) for a in agents], [env.action_space(a) for a in agents]
learner = IPPO(*spaces, agent_ids=agents, learn_step=64, batch_size=32)

# To train it:
# envs = agilerl.vector.pz_async_vec_env.AsyncPettingZooVecEnv([make, make])
# train_multi_agent_on_policy(envs, "chase", "IPPO", [learner], ...)
