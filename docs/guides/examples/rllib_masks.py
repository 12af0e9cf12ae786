"""A module of RLlib for planes, row numbers (`index`) and action masks."""

# needs: ray.rllib
import numpy as np
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.apis import ValueFunctionAPI
from ray.rllib.core.rl_module.torch import TorchRLModule

masked = {"mask_bumps": True, "mask_in_observation": True}


class SmallNet(TorchRLModule, ValueFunctionAPI):
    def setup(self):
        space = self.observation_space["observation"]
        rows, cells = int(space.high.max()) + 1, int(np.prod(space.shape))
        flat = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(cells, 64), torch.nn.Tanh())
        self.body = torch.nn.EmbeddingBag(rows, 64, mode="sum") if space.dtype.kind == "i" else flat
        self.policy, self.value = torch.nn.Linear(64, self.action_space.n), torch.nn.Linear(64, 1)

    def _forward(self, batch, **_):
        logits = self.policy(self.body(batch["obs"]["observation"]))
        return {"action_dist_inputs": logits.masked_fill(batch["obs"]["action_mask"] == 0, -1e9)}

    def compute_values(self, batch, embeddings=None):
        return self.value(self.body(batch["obs"]["observation"])).squeeze(-1)


configs = [
    PPOConfig()
    .environment("pursuit:pursuit/Maze-v0", env_config={"observation": seen, **masked})
    .rl_module(rl_module_spec=RLModuleSpec(module_class=SmallNet))
    .env_runners(num_env_runners=0)
    .training(train_batch_size_per_learner=400, minibatch_size=200, num_epochs=1)
    for seen in ("planes", "index")
]
