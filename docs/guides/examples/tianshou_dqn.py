"""DQN of Tianshou, through Gymnasium; and masks, which it takes from PettingZoo."""

# needs: tianshou
import gymnasium
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, PettingZooEnv
from tianshou.utils.net.common import Net

import pursuit  # noqa: F401 -- registers the environments
from pursuit import maze_v0

env = gymnasium.make("pursuit/Maze-v0", maze="3x3", num_goals=1)
envs = DummyVectorEnv([lambda: gymnasium.make("pursuit/Maze-v0", maze="3x3", num_goals=1)] * 4)
net = Net(state_shape=env.observation_space.shape, action_shape=4, hidden_sizes=[64])
policy = DiscreteQLearningPolicy(model=net, action_space=env.action_space, eps_training=0.2)
learner = DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), target_update_freq=100)
collector = Collector(learner, envs, VectorReplayBuffer(4000, 4), exploration_noise=True)

masked = {"mask_bumps": True, "mask_in_observation": True}
game = {"maze": "3x3", "num_goals": 1, **masked}
observed, _ = PettingZooEnv(maze_v0.env(**game)).reset(seed=0)
print(observed["mask"])
