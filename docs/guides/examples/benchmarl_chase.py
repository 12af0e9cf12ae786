"""A chase of two against two as a task of BenchMARL."""

# needs: benchmarl
from benchmarl.environments.pettingzoo.common import PettingZooClass
from torchrl.envs import PettingZooWrapper

from pursuit import chase_v0


class Chase(PettingZooClass):
    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        how = {"categorical_actions": True, "return_state": True, "seed": seed, "device": device}
        how |= {"use_mask": True, "done_on_any": False}
        return lambda: PettingZooWrapper(chase_v0.parallel_env(**self.config), **how)

    def supports_discrete_actions(self):
        return True

    def has_state(self):
        return True


task = Chase("CHASE", {"maze": "3x3", "num_chasers": 2, "num_evaders": 2, "max_cycles": 50})

# To train it: Experiment(task=task, algorithm_config=MappoConfig.get_from_yaml(), ...)
