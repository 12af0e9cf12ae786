"""DDPG, TD3 and SAC: actor-critic algorithms for continuous actions with a replay buffer."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from copy import deepcopy
from typing import Any, Generic, TypeVar

import torch

from curricula import linear
from train.algorithms.action_noise import ActionNoise
from train.algorithms.collector import Collector, Columns
from train.algorithms.continuous_losses import (
    critic_loss,
    deterministic_actor_loss,
    next_action,
    returns_to_expect,
    soft_actor_loss,
    temperature_loss,
)
from train.algorithms.learner import Build, backward, clip_gradients, step_adam
from train.algorithms.off_policy import OffPolicyLearner
from train.algorithms.replay import Batch
from train.networks.continuous import Critics, DeterministicActor, GaussianActor, polyak_update
from train.networks.policy import Player
from train.settings.off_policy import (
    ContinuousSettings,
    SACSettings,
    TD3Settings,
)

Actor = TypeVar("Actor", DeterministicActor, GaussianActor)
Figures = dict[str, torch.Tensor]


class ContinuousLearner(OffPolicyLearner, Generic[Actor]):
    """The base class: exploration, the update of the critics, and target networks.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        actor: the policy.
        critics: the action value networks.
        device: of the networks.
        seed: of the draws from the replay buffer and of exploration.
    """

    network: Actor

    def __init__(
        self,
        settings: ContinuousSettings,
        env: Any,
        actor: Actor,
        critics: Critics,
        device: str,
        seed: int,
    ) -> None:
        actions = env.player.num_actions
        noise = ActionNoise(settings.noise, settings.noise_theta, env.num_games, actions, seed)
        collector = Collector(
            env, self.act, settings.rollout_steps, 0, device, keep_next=True, ended=noise.restart
        )
        super().__init__(settings, env, actor, collector, device, seed)
        self.noise, self.random_actions = noise, True
        self.chosen, self.critics, self.num_actions = settings, critics, actions
        self.target_critics = deepcopy(critics).requires_grad_(False)
        self.critic_optimizer = torch.optim.Adam(
            critics.parameters(),
            lr=settings.critic_learning_rate,
            betas=(settings.adam_beta1, 0.999),
            eps=settings.adam_epsilon,
            fused=True,
        )

    @property
    def parts(self) -> dict[str, Any]:
        """Networks and optimisers other than the actor's, by their names in checkpoints."""
        return {
            "critics": self.critics,
            "target_critics": self.target_critics,
            "critic_optimizer": self.critic_optimizer,
        }

    def explore(self, progress: float) -> dict[str, float]:
        """Anneal the noise; before `learning_starts` actions are uniformly random."""
        settings = self.chosen
        share = min(progress / max(settings.noise_share, 1e-9), 1.0)
        self.noise.std = linear(settings.noise_start, settings.noise_end, share)
        self.random_actions = self.frames < settings.learning_starts
        return {} if settings.noise == "none" else {"noise": self.noise.std}

    def act(self, seen: Columns, state: torch.Tensor) -> tuple[Columns, torch.Tensor]:
        """The actor's action with noise, or a uniformly random one: in [-1, 1], on the CPU."""
        noise = self.noise
        if self.random_actions:
            return {"action": noise.uniform()}, state
        drawn = noise.normal().to(self.device) if isinstance(self.network, GaussianActor) else None
        action = self.network.act(seen["observation"], drawn).cpu()
        if noise.kind != "none":
            action = (action + noise.step()).clamp_(-1.0, 1.0)
        return {"action": action}, state

    def set_schedules(self, progress: float) -> None:
        """Set also the learning rate of the critics."""
        super().set_schedules(progress)
        rate = self.annealed(self.chosen.critic_learning_rate, progress)
        self.critic_optimizer.param_groups[0]["lr"] = rate

    def learn(self, batch: Batch) -> tuple[torch.Tensor, Figures]:
        """A gradient step of the critics, and every `policy_delay` steps of actor and targets."""
        prepare = self.network.trunk.prepare
        prepared, following = prepare(batch["observation"]), prepare(batch["next_observation"])
        with torch.no_grad():
            values = self.next_values(following)
        goal = returns_to_expect(batch, values, self.chosen.gamma)
        found = self.critics(prepared, batch["action"])
        loss, error = critic_loss(found, goal, batch)
        self.step(self.critic_optimizer, loss)
        figures = {"critic_loss": loss.detach(), "value": found.detach().mean()}
        self.updates += 1
        if self.updates % self.chosen.policy_delay == 0:
            self.learn_actor(prepared, batch)
            self.update_targets()
        return error, figures

    @abstractmethod
    def next_values(self, following: torch.Tensor) -> torch.Tensor:
        """[batch]: the values of the next observations, by the target networks."""

    @abstractmethod
    def learn_actor(self, prepared: torch.Tensor, batch: Batch) -> None:
        """A gradient step of the actor."""

    def update_targets(self) -> None:
        """Update the target networks."""
        polyak_update(self.target_critics, self.critics, self.chosen.tau)

    def step(self, optimizer: torch.optim.Adam, loss: torch.Tensor) -> None:
        """One step of Adam, with the gradient clipped to the norm `max_grad_norm`."""
        optimizer.zero_grad(set_to_none=True)
        backward(loss)
        clip_gradients(optimizer.param_groups[0]["params"], self.chosen.max_grad_norm)
        step_adam(optimizer)

    def state_dict(self) -> dict[str, Any]:
        """The state, with that of the noise."""
        state = super().state_dict() | {"noise": self.noise.state_dict()}
        return state | {name: part.state_dict() for name, part in self.parts.items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.noise.load_state_dict(state["noise"])
        for name, part in self.parts.items():
            part.load_state_dict(state[name])


class DDPG(ContinuousLearner[DeterministicActor]):
    """Lillicrap et al. (2016)."""

    target_noise = target_noise_clip = 0.0

    def __init__(
        self,
        settings: ContinuousSettings,
        env: Any,
        actor: DeterministicActor,
        critics: Critics,
        device: str,
        seed: int,
    ) -> None:
        super().__init__(settings, env, actor, critics, device, seed)
        self.target_actor = deepcopy(actor).requires_grad_(False)

    @property
    def parts(self) -> dict[str, Any]:
        """As in the base class, with the target actor."""
        return {**super().parts, "target_actor": self.target_actor}

    def next_values(self, following: torch.Tensor) -> torch.Tensor:
        """The minimum of the target critics for the target actor's action."""
        clip = self.target_noise_clip
        action = next_action(self.target_actor, following, self.target_noise, clip)
        return self.target_critics(following, action).amin(dim=0)

    def learn_actor(self, prepared: torch.Tensor, batch: Batch) -> None:
        """A gradient step of the actor towards higher values."""
        loss = deterministic_actor_loss(self.network, self.critics, prepared, batch)
        self.step(self.optimizer, loss)

    def update_targets(self) -> None:
        """Update the target networks."""
        super().update_targets()
        polyak_update(self.target_actor, self.network, self.chosen.tau)

    def policy(self, greedy: bool = True) -> Any:
        """The greedy policy; otherwise ValueError, as the policy is deterministic."""
        if not greedy:
            raise ValueError(
                "ddpg and td3 learn no distribution over actions; use the greedy policy"
            )
        return super().policy()


class TD3(DDPG):
    """Fujimoto et al. (2018): two critics, target policy smoothing, delayed actor updates."""

    def __init__(self, settings: TD3Settings, *arguments: Any) -> None:
        super().__init__(settings, *arguments)
        self.target_noise = settings.target_noise
        self.target_noise_clip = settings.target_noise_clip


class SAC(ContinuousLearner[GaussianActor]):
    """Haarnoja et al. (2018): entropy-regularised, with an adaptive temperature.

    Attributes:
        log_alpha: logarithm of the temperature, the weight of the entropy.
        target_entropy: of the actor's distribution, in nats.
    """

    def __init__(
        self,
        settings: SACSettings,
        env: Any,
        actor: GaussianActor,
        critics: Critics,
        device: str,
        seed: int,
    ) -> None:
        super().__init__(settings, env, actor, critics, device, seed)
        self.soft = settings
        self.target_entropy = settings.target_entropy * self.num_actions
        start = torch.tensor(settings.temperature, device=device).log()
        self.log_alpha = torch.nn.Parameter(start, requires_grad=settings.adapt_temperature)
        self.temperature_optimizer = torch.optim.Adam(
            [self.log_alpha], lr=settings.temperature_learning_rate, fused=True
        )

    @property
    def parts(self) -> dict[str, Any]:
        """As in the base class, with the temperature's optimiser."""
        return {**super().parts, "temperature_optimizer": self.temperature_optimizer}

    def set_schedules(self, progress: float) -> None:
        """Set also the learning rate of the temperature."""
        super().set_schedules(progress)
        rate = self.annealed(self.soft.temperature_learning_rate, progress)
        self.temperature_optimizer.param_groups[0]["lr"] = rate

    def learn(self, batch: Batch) -> tuple[torch.Tensor, Figures]:
        """A gradient step of the critics, the actor and the temperature."""
        error, figures = super().learn(batch)
        return error, {**figures, "temperature": self.log_alpha.detach().exp()}

    def next_values(self, following: torch.Tensor) -> torch.Tensor:
        """The minimum of the target critics for a drawn action, plus the entropy bonus."""
        action, log_prob = self.network.draw(following)
        values = self.target_critics(following, action).amin(dim=0)
        return values - self.log_alpha.exp() * log_prob

    def learn_actor(self, prepared: torch.Tensor, batch: Batch) -> None:
        """A gradient step of the actor towards higher values and entropy; then the temperature."""
        alpha = self.log_alpha.detach().exp()
        loss, log_prob = soft_actor_loss(self.network, self.critics, prepared, batch, alpha)
        self.step(self.optimizer, loss)
        if self.soft.adapt_temperature:
            self.temperature_optimizer.zero_grad(set_to_none=True)
            target = self.target_entropy
            torch.autograd.backward(temperature_loss(self.log_alpha, log_prob, target, batch))
            self.temperature_optimizer.step()

    def state_dict(self) -> dict[str, Any]:
        """The state, with the temperature."""
        return super().state_dict() | {"log_alpha": self.log_alpha.detach()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        with torch.no_grad():
            self.log_alpha.copy_(state["log_alpha"])


def actor_maker(form: Any) -> Callable[[ContinuousSettings, Player, Build], Any]:
    """A function that builds an actor of this class with new weights."""

    def actor_of(settings: ContinuousSettings, player: Player, how: Build) -> Any:
        return form(player.features, player.num_actions, how.hidden(settings)).to(how.device)

    return actor_of


def builder(learner: Any, actor_of: Any, num_critics: int) -> Callable[[Any, Any, Build], Any]:
    """A function that builds a learner for an environment, with `num_critics` critics."""

    def build(settings: ContinuousSettings, env: Any, how: Build) -> Any:
        player, actor = env.player, actor_of(settings, env.player, how)
        sizes = (player.features, player.num_actions, how.hidden(settings), num_critics)
        critics = Critics(*sizes).to(how.device)
        return learner(settings, env, actor, critics, how.device, how.seed)

    return build


deterministic_of, gaussian_of = actor_maker(DeterministicActor), actor_maker(GaussianActor)
build_ddpg = builder(DDPG, deterministic_of, 1)
build_td3 = builder(TD3, deterministic_of, 2)
build_sac = builder(SAC, gaussian_of, 2)
