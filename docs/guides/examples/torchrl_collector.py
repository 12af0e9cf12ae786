"""Rollouts of TorchRL's collector with a policy of your own."""

# needs: torchrl
import gymnasium
import torch
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import ProbabilisticActor

import pursuit  # noqa: F401 -- registers the environments

envs = gymnasium.make_vec("pursuit/Chaser-v0", num_envs=8, autoreset_mode="DISABLED")
env = GymWrapper(envs, categorical_action_encoding=True)
network = torch.nn.Sequential(torch.nn.LazyLinear(64), torch.nn.Tanh(), torch.nn.LazyLinear(4))
logits = TensorDictModule(network, ["observation"], ["logits"])
categorical = torch.distributions.Categorical
actor = ProbabilisticActor(logits, in_keys=["logits"], distribution_class=categorical)
sizes = {"frames_per_batch": 1600, "total_frames": 3200}
collector = Collector(env, actor, **sizes, auto_register_policy_transforms=True)
shapes = [batch["next", "reward"].shape for batch in collector]  # two of [8, 200, 1]
collector.shutdown()
