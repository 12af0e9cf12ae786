"""DDPG, TD3 and SAC: actor-critic algorithms for continuous actions with a replay buffer."""

from __future__ import annotations

from abc import abstractmethod
from copy import deepcopy
from typing import ClassVar, Generic, TypeVar

import torch

from curricula import linear
from train.algorithms.action_noise import ActionNoise
from train.algorithms.adam import Adam
from train.algorithms.collector import Collector, Columns
from train.algorithms.continuous_losses import (
    critic_loss,
    deterministic_actor_loss,
    next_action,
    soft_actor_loss,
    temperature_loss,
)
from train.algorithms.learner import Build, HasState, VecEnv
from train.algorithms.off_policy import OffPolicyLearner
from train.algorithms.replay import Minibatch, returns_to_expect
from train.algorithms.rollouts import Figures
from train.networks.continuous import Critics, DeterministicActor, GaussianActor, polyak_update
from train.networks.seat import Seat
from train.settings.off_policy import ContinuousSettings, SACSettings, TD3Settings
from train.tensors import StateDict

Actor = TypeVar("Actor", DeterministicActor, GaussianActor)


class ContinuousLearner(OffPolicyLearner, Generic[Actor]):
    """The base class: exploration, the update of the critics, and target networks.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        options: of this machine.

    Attributes:
        network, critics, target_critics: the actor, and the action value networks.
        noise: of the exploration.
        FORM, CRITICS: the class of the actor, and the number of critics.
    """

    FORM: ClassVar[type[DeterministicActor] | type[GaussianActor]]
    CRITICS: ClassVar[int] = 2
    settings: ContinuousSettings
    network: Actor

    def __init__(self, settings: ContinuousSettings, env: VecEnv, options: Build) -> None:
        seat, device, steps = env.player, options.device, settings.rollout_steps
        self.num_actions = seat.num_actions
        actor = self.network_of(settings, seat, options)
        hidden = options.hidden(settings)
        critics = Critics(seat.features, self.num_actions, hidden, self.CRITICS).to(device)
        noise = (settings.noise, settings.noise_theta, env.num_games)
        self.noise = ActionNoise(*noise, self.num_actions, options.seed)
        self.random_actions = True
        ended = self.noise.restart
        collector = Collector(env, self.act, steps, 0, device, keep_next=True, ended=ended)
        super().__init__(settings, env, actor, collector, device, options.seed)
        self.critics, self.target_critics = critics, deepcopy(critics).requires_grad_(False)
        weights, rate = critics.parameters(), settings.critic_learning_rate
        self.critic_optimizer = self.new_optimizer(weights, rate)

    @classmethod
    def network_of(
        cls, settings: ContinuousSettings, seat: Seat, options: Build
    ) -> DeterministicActor | GaussianActor:
        """A new actor for the seat."""
        actor = cls.FORM(seat.features, seat.num_actions, options.hidden(settings))
        return actor.to(options.device)

    def parts(self) -> dict[str, HasState]:
        """As of `NetworkLearner`, with the critics and the noise."""
        return {
            **super().parts(),
            "critics": self.critics,
            "target_critics": self.target_critics,
            "critic_optimizer": self.critic_optimizer,
            "noise": self.noise,
        }

    def explore(self, progress: float) -> dict[str, float]:
        """Anneal the noise; before `learning_starts` actions are uniformly random."""
        settings = self.settings
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

    def learn(self, batch: Minibatch) -> tuple[torch.Tensor, Figures]:
        """A gradient step of the critics, and every `policy_delay` steps of actor and targets."""
        prepare = self.network.trunk.prepare
        prepared, following = prepare(batch["observation"]), prepare(batch["next_observation"])
        with torch.no_grad():
            values = self.next_values(following)
        target = returns_to_expect(batch, values, self.settings.gamma)
        predicted = self.critics(prepared, batch["action"])
        loss, error = critic_loss(predicted, target, batch)
        self.descend(loss, self.critic_optimizer)
        figures = {"critic_loss": loss.detach(), "value": predicted.detach().mean()}
        self.updates += 1
        if self.updates % self.settings.policy_delay == 0:
            self.learn_actor(prepared, batch)
            self.update_targets()
        return error, figures

    @abstractmethod
    def next_values(self, following: torch.Tensor) -> torch.Tensor:
        """[batch]: the values of the next observations, by the target networks."""

    @abstractmethod
    def learn_actor(self, prepared: torch.Tensor, batch: Minibatch) -> None:
        """A gradient step of the actor."""

    def update_targets(self) -> None:
        """Update the target networks."""
        polyak_update(self.target_critics, self.critics, self.settings.tau)


class DDPG(ContinuousLearner[DeterministicActor]):
    """Lillicrap et al. (2016)."""

    FORM = DeterministicActor
    CRITICS = 1
    COPIES = ("target_actor",)
    NO_DISTRIBUTION = "ddpg and td3 learn no distribution over actions"

    def __init__(self, settings: ContinuousSettings, env: VecEnv, options: Build) -> None:
        super().__init__(settings, env, options)
        self.target_actor = deepcopy(self.network).requires_grad_(False)

    def parts(self) -> dict[str, HasState]:
        """As in the base class, with the target actor."""
        return {**super().parts(), "target_actor": self.target_actor}

    def next_action(self, following: torch.Tensor) -> torch.Tensor:
        """[batch, actions]: the actions of the target actor."""
        return next_action(self.target_actor, following, 0.0, 0.0)

    def next_values(self, following: torch.Tensor) -> torch.Tensor:
        """The minimum of the target critics for the target actor's action."""
        return self.target_critics(following, self.next_action(following)).amin(dim=0)

    def learn_actor(self, prepared: torch.Tensor, batch: Minibatch) -> None:
        """A gradient step of the actor towards higher values."""
        self.descend(deterministic_actor_loss(self.network, self.critics, prepared, batch))

    def update_targets(self) -> None:
        """Update the target networks."""
        super().update_targets()
        polyak_update(self.target_actor, self.network, self.settings.tau)


class TD3(DDPG):
    """Fujimoto et al. (2018): two critics, target policy smoothing, delayed actor updates."""

    CRITICS = 2
    settings: TD3Settings

    def next_action(self, following: torch.Tensor) -> torch.Tensor:
        """[batch, actions]: the actions of the target actor, smoothed by clipped noise."""
        noise = self.settings.target_noise, self.settings.target_noise_clip
        return next_action(self.target_actor, following, *noise)


class SAC(ContinuousLearner[GaussianActor]):
    """Haarnoja et al. (2018): entropy-regularised, with an adaptive temperature.

    Attributes:
        log_alpha: logarithm of the temperature, the weight of the entropy.
        target_entropy: of the actor's distribution, in nats.
    """

    FORM = GaussianActor
    settings: SACSettings

    def __init__(self, settings: SACSettings, env: VecEnv, options: Build) -> None:
        super().__init__(settings, env, options)
        self.target_entropy = settings.target_entropy * self.num_actions
        start = torch.tensor(settings.temperature, device=options.device).log()
        self.log_alpha = torch.nn.Parameter(start, requires_grad=settings.adapt_temperature)
        rate = settings.temperature_learning_rate
        self.temperature_optimizer = Adam([self.log_alpha], rate)
        self.rates.append((self.temperature_optimizer, rate))

    def parts(self) -> dict[str, HasState]:
        """As in the base class, with the temperature's optimiser."""
        return {**super().parts(), "temperature_optimizer": self.temperature_optimizer}

    def learn(self, batch: Minibatch) -> tuple[torch.Tensor, Figures]:
        """A gradient step of the critics, the actor and the temperature."""
        error, figures = super().learn(batch)
        return error, {**figures, "temperature": self.log_alpha.detach().exp()}

    def next_values(self, following: torch.Tensor) -> torch.Tensor:
        """The minimum of the target critics for a drawn action, plus the entropy bonus."""
        action, log_prob = self.network.draw(following)
        values = self.target_critics(following, action).amin(dim=0)
        return values - self.log_alpha.exp() * log_prob

    def learn_actor(self, prepared: torch.Tensor, batch: Minibatch) -> None:
        """A gradient step of the actor towards higher values and entropy; then the temperature."""
        alpha = self.log_alpha.detach().exp()
        loss, log_prob = soft_actor_loss(self.network, self.critics, prepared, batch, alpha)
        self.descend(loss)
        if self.settings.adapt_temperature:
            self.temperature_optimizer.zero_grad()
            target = self.target_entropy
            torch.autograd.backward(temperature_loss(self.log_alpha, log_prob, target, batch))
            self.temperature_optimizer.step()

    def state_dict(self) -> StateDict:
        """The state, with the temperature."""
        return super().state_dict() | {"log_alpha": self.log_alpha.detach()}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        with torch.no_grad():
            self.log_alpha.copy_(state["log_alpha"])
