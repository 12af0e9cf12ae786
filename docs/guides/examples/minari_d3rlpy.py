"""Episodes of a scripted chaser as a dataset of Minari, from which d3rlpy learns."""

# needs: minari
# needs: d3rlpy
import d3rlpy
import gymnasium
import minari

import pursuit
from scripted_agents import AStarChaser

games = gymnasium.make("pursuit/Chaser-v0", maze="5x5", opponent_epsilon=0.2)
if "pursuit/astar-v0" not in minari.list_local_datasets():
    pursuit.export_minari("pursuit/astar-v0", games, AStarChaser(), episodes=100)

dataset, env = d3rlpy.datasets.get_minari("pursuit/astar-v0")
offline = d3rlpy.algos.DiscreteCQLConfig(batch_size=64).create()
evaluators = {"return": d3rlpy.metrics.EnvironmentEvaluator(env, n_trials=5)}
offline.fit(dataset, n_steps=20, n_steps_per_epoch=10, evaluators=evaluators)
