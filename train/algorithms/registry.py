"""The learners, all behind one interface (`learner.Learner`), and what makes them from settings."""

from __future__ import annotations

from typing import Any

from pursuit.policy import Policy
from pursuit.simulator import Simulator
from train.algorithms.learner import Learner
from train.environments.simulator_env import SimulatorEnv
from train.networks.actor_critic import ActorCritic, CentralActorCritic, QNetwork
from train.networks.policy import LearnedPolicy
from train.settings.algorithms import (
    A2CSettings,
    ActorCriticSettings,
    CrossEntropySettings,
    DQNSettings,
    NetworkSettings,
    PPOSettings,
    QLearningSettings,
    ReinforceSettings,
)
from train.settings.run import TrainSettings
from train.teaching.teacher import training_task

__all__ = ["Learner", "build_network", "make_learner", "policy_of"]


def build_network(settings: TrainSettings[Any], bfloat16: bool = False) -> ActorCritic | QNetwork:
    """The network of a run, with fresh weights, on its device.

    Raises:
        ValueError: the algorithm has none.
    """
    task, hyper = training_task(settings), settings.hyper
    encoder = Simulator(task).encoder(settings.observation)
    sizes = (encoder, task.num_agents, task.num_actions)
    form: Any = None if settings.first_layer == "auto" else settings.first_layer
    if isinstance(hyper, CrossEntropySettings):
        return ActorCritic(*sizes, hyper.width, form="dense", activation=hyper.activation)
    if not isinstance(hyper, NetworkSettings):
        raise ValueError(f"{settings.algorithm} has no network")
    if isinstance(hyper, PPOSettings) and hyper.central_critic:
        role = task.seat_roles[task.seat(settings.task.agent)]
        inner: Any = (hyper.width, bfloat16, hyper.first_std, hyper.activation)
        return CentralActorCritic(*sizes, task.count(role), *inner).to(settings.device)
    rest: tuple[Any, ...] = (form, bfloat16, hyper.first_std, hyper.activation)
    network: ActorCritic | QNetwork
    if isinstance(hyper, DQNSettings):
        network = QNetwork(*sizes, hyper.width, hyper.dueling, *rest)
    else:
        assert isinstance(hyper, ActorCriticSettings)
        network = ActorCritic(*sizes, hyper.width, hyper.shared, *rest)
    return network.to(settings.device)


def make_learner(
    settings: TrainSettings[Any], env: SimulatorEnv, bfloat16: bool = False
) -> Learner:
    """The learner of a run over its games.

    Raises:
        ValueError: a combination that this algorithm cannot do.
    """
    hyper, device = settings.hyper, settings.device
    if isinstance(hyper, QLearningSettings):
        from train.algorithms.q_learning import QLearning

        return QLearning(hyper, env, settings.seed)
    network: Any = build_network(settings, bfloat16)
    if isinstance(hyper, CrossEntropySettings):
        from train.algorithms.cross_entropy import CrossEntropy

        return CrossEntropy(hyper, env, network, settings.seed)
    if isinstance(hyper, DQNSettings):
        from train.algorithms.dqn import DQN

        target: Any = build_network(settings, bfloat16)
        return DQN(hyper, env, network, target, device, settings.seed)
    if isinstance(hyper, PPOSettings):
        from train.algorithms.ppo import PPO

        return PPO(hyper, env, network, device)
    from train.algorithms.a2c import A2C, Reinforce

    if isinstance(hyper, A2CSettings):
        return A2C(hyper, env, network, device)
    assert isinstance(hyper, ReinforceSettings)
    return Reinforce(hyper, env, network, device)


def policy_of(settings: TrainSettings[Any], state: dict[str, Any], greedy: bool = True) -> Policy:
    """The policy in what `Learner.state_dict` gave, on the CPU.

    Raises:
        KeyError, RuntimeError: a state of other settings.
    """
    task = training_task(settings)
    if isinstance(settings.hyper, QLearningSettings):
        from train.algorithms.q_learning import policy_from_state

        return policy_from_state(task, settings.task.agent, state)
    from dataclasses import replace

    network = build_network(replace(settings, device="cpu", first_layer="auto"))
    network.load_state_dict(state["network"])
    return LearnedPolicy(network, task, settings.task.agent, settings.observation, greedy)
