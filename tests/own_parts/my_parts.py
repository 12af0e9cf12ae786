"""One part of each kind, as a user of Pursuit would write it: outside of its packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from curricula import Change, Curriculum, Outcomes, Progress
from pursuit import GameView, Rewards, Simulator, Task
from pursuit.rules import CHASER
from pursuit.tasks.moments import After, Before
from train.algorithms.learner import Build, LearnedNetwork, NetworkLearner, network_loader
from train.algorithms.registry import Algorithm
from train.environments.vector_env import LearnerVectorEnv
from train.networks.features import Features
from train.networks.flat import FlatInputs, FlatNetwork
from train.networks.q_network import QNetwork
from train.networks.seat import Seat
from train.self_play.meta_game import Payoffs
from train.self_play.pool import OpponentPool
from train.settings.algorithms import LibraryPPOSettings, NetworkSettings
from train.settings.curricula import AxisSettings, OwnCurriculum, StagedSettings
from train.teaching.axes import Axis, Maker
from train.teaching.context import CurriculumContext

# -- rewards ---------------------------------------------------------------------------------------


def apart(moment: Before | After) -> NDArray[Any]:
    """[games] steps between the first two agents."""
    one, two = moment.positions[:, 0], moment.positions[:, 1]
    return moment.distances[moment.maze_index, one, two]


def shaped(before: Before, actions: NDArray[np.int32], after: After) -> NDArray[Any]:
    """The usual payment, and 0.05 for every step that a chaser comes nearer (an evader farther)."""
    nearer = apart(before) - apart(after)
    sign = np.where(after.roles == CHASER, 1.0, -1.0)
    return after.rewards + 0.05 * nearer[:, None] * sign


@numba.njit
def tired(before: Any, actions: Any, after: Any) -> Any:
    """-1 for every agent that has changed its cell: compiled, game by game."""
    paid = np.zeros(actions.shape)
    for game in range(actions.shape[0]):
        for agent in range(actions.shape[1]):
            if after.positions[game, agent] != before.positions[game, agent]:
                paid[game, agent] = -1.0
    return paid


THRIFTY: Mapping[str, Rewards] = {"chaser": Rewards(step=-0.5, capture=2.0)}
"""Coefficients under a name are a part as well."""

# -- an observation --------------------------------------------------------------------------------


class Compass:
    """Rows and columns from oneself to every agent and goal; 0 for who is gone, and for oneself."""

    def space(self, task: Task) -> gymnasium.spaces.Box:
        """Float32 [2 * (agents + goals)], between -1 and 1."""
        return gymnasium.spaces.Box(-1.0, 1.0, (2 * (task.num_agents + task.num_goals),))

    def encode(self, task: Task, games: Before, seats: NDArray[np.intp]) -> NDArray[Any]:
        """[games, seats, 2 * (agents + goals)]."""
        maze = task.mazes[0]
        cells = np.concatenate([games.positions, np.maximum(games.goals, 0)], axis=1)
        there = np.concatenate([games.active != 0, games.goals >= 0], axis=1)
        places = np.stack([maze.rows / maze.height, maze.columns / maze.width], axis=-1)[cells]
        away = places[:, None] - places[:, seats, None]
        seen = np.where(there[:, None, :, None], away, 0.0).astype(np.float32)
        return seen.reshape(len(games.steps), len(seats), -1)


class Clock(Compass):
    """The compass, and the time in its first number: no function of the cells any more."""

    def encode(self, task: Task, games: Before, seats: NDArray[np.intp]) -> NDArray[Any]:
        """As of the compass."""
        seen = super().encode(task, games, seats)
        seen[..., 0] = (games.steps / task.max_steps)[:, None]
        return seen


class Map:
    """Where everybody is, as pictures [agents, height, width] for convolutions."""

    def space(self, task: Task) -> gymnasium.spaces.Box:
        """uint8, 255 where an agent is."""
        maze = task.mazes[0]
        return gymnasium.spaces.Box(0, 255, (task.num_agents, maze.height, maze.width), np.uint8)

    def encode(self, task: Task, games: Before, seats: NDArray[np.intp]) -> NDArray[Any]:
        """[games, seats, agents, height, width]: oneself first."""
        maze, count = task.mazes[0], len(games.steps)
        drawn = np.zeros((count, task.num_agents, maze.height, maze.width), dtype=np.uint8)
        game, agent = np.nonzero(games.active)
        cell = games.positions[game, agent]
        drawn[game, agent, maze.rows[cell], maze.columns[cell]] = 255
        every = np.arange(task.num_agents)
        return np.stack([drawn[:, np.roll(every, -seat)] for seat in seats], axis=1)


# -- networks --------------------------------------------------------------------------------------


def picture(features: Features, width: int) -> nn.Module:
    """Convolutions of its own over planes."""
    return nn.Sequential(
        nn.LazyConv2d(8, 3, padding=1), nn.ELU(), nn.Flatten(), nn.LazyLinear(width), nn.ELU()
    )


class Words(nn.Module):
    """Of "index": a vector for each number, summed up."""

    def __init__(self, features: Features, width: int) -> None:
        super().__init__()
        self.table = nn.Embedding(len(features.rows), width)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[batch, width]."""
        summed: torch.Tensor = self.table(observation).sum(-2)
        return summed.tanh()


def straight(features: Features, width: int) -> nn.Module:
    """One layer."""
    return nn.LazyLinear(width)


def noisy(features: Features, width: int) -> nn.Module:
    """Of flat observations, with dropout and with statistics of batches."""
    size = int(np.prod(features.shape))
    return nn.Sequential(
        nn.Flatten(), nn.Linear(size, width), nn.BatchNorm1d(width), nn.ReLU(), nn.Dropout(0.5)
    )


def too_wide(features: Features, width: int) -> nn.Module:
    """Not what it was asked for."""
    return Words(features, width + 1)


def no_module(features: Features, width: int) -> int:
    """None at all."""
    return width


# -- a policy --------------------------------------------------------------------------------------


class Sneaky:
    """An evader that steps to whatever neighbouring cell is farthest from the first chaser."""

    roles = ("evader",)

    def __init__(self, task: Task, role: str) -> None:
        self.task = task

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[games] int32."""
        maze = view.task.mazes[0]
        after = maze.neighbors[view.positions[:, view.seat], : view.task.num_actions]
        away = maze.distances[after, view.positions[:, :1]]
        return away.argmax(axis=1).astype(np.int32)


# -- an axis and a curriculum ----------------------------------------------------------------------


def _make_far(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    longest = context.task.mazes[0].longest_distance

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, min_start_distance=values.astype(np.int64))

    return Axis(name, 1, max(longest - 2, 1), apply)


FAR = Maker(_make_far, random_starts=True, both=True)
"""An axis: chasers and evaders begin ever farther apart."""


@dataclass(frozen=True)
class AlternatingSettings(StagedSettings):
    """Two stages in turn: the easiest and the hardest."""

    period: int = 10
    """Updates between two turns."""


class Alternating:
    """The first stage, then the last, then the first again."""

    def __init__(self, stages: list[float], period: int) -> None:
        self.stages, self.period, self.updates = stages, period, 0

    @property
    def value(self) -> float:
        """The current stage."""
        return self.stages[0 if (self.updates // self.period) % 2 == 0 else -1]

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Count; log a change."""
        before, self.updates = self.value, self.updates + 1
        if self.value == before:
            return []
        return [Change(self.value, self.value, self.value, f"turn after {self.updates} updates")]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """The same for all games."""
        return np.full(num_games, self.value)

    def state_dict(self) -> dict[str, Any]:
        """The count."""
        return {"updates": self.updates}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        self.updates = state["updates"]


def _make_alternating(settings: AlternatingSettings, axis: Axis, seed: int) -> Curriculum:
    return Alternating(axis.stages(settings.num_stages), settings.period)


ALTERNATING = OwnCurriculum(AlternatingSettings, _make_alternating)

# -- a rule that draws opponents ------------------------------------------------------------------


def the_oldest(pool: OpponentPool, payoffs: Payoffs, progress: float) -> NDArray[np.float64]:
    """The latest and the oldest snapshot, alike."""
    found = np.zeros(len(pool.members))
    found[[0, pool.names.index(pool.snapshots[0].name) if pool.snapshots else 0]] = 1.0
    return found


def hardest(pool: OpponentPool, payoffs: Payoffs, progress: float) -> list[float]:
    """The latest until half of the budget is used; then the snapshot with the best payoffs."""
    if progress < 0.5 or not pool.snapshots:
        return [1.0] + [0.0] * (len(pool.members) - 1)
    against = payoffs.matrix().mean(axis=0 if pool.role == "evader" else 1)
    best = against.argmax() if pool.role == "evader" else against.argmin()
    return [float(name == payoffs.names(pool.role)[best]) for name in pool.names]


RETURNED: list[Any] = [None]


def wrong(pool: OpponentPool, payoffs: Payoffs, progress: float) -> Any:
    """What a test chose."""
    return RETURNED[0]


def of_the_pool(pool: OpponentPool) -> list[float]:
    """A rule with the wrong signature."""
    return [1.0] * len(pool.members)


# -- a command -------------------------------------------------------------------------------------


def greet(arguments: Sequence[str]) -> None:
    """`pursuit my_parts:greet`."""
    print("greetings to", *arguments)


# -- an algorithm ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class SarsaSettings(NetworkSettings):
    """On-policy temporal differences (Rummery and Niranjan, 1994) with a network."""

    num_games: int = 256
    """Games simulated in parallel."""
    learning_rate: float = 3e-3
    """Initial learning rate of Adam."""
    epsilon_start: float = 0.1
    """Share of random actions."""


class Sarsa(NetworkLearner):
    """One gradient step a step of all games, towards r + gamma Q(s', a') of the action taken."""

    network: QNetwork

    def __init__(self, settings: SarsaSettings, env: Any, network: QNetwork, device: str) -> None:
        super().__init__(settings, env, network, device)
        self.settings, self.now, self.actions = settings, None, None

    def choose(self, observation: torch.Tensor) -> torch.Tensor:
        """[batch] int64, epsilon-greedy."""
        with torch.no_grad():
            greedy = self.network(observation).argmax(dim=-1)
        drawn = torch.randint(self.env.player.num_actions, greedy.shape)
        return torch.where(torch.rand(greedy.shape) < self.settings.epsilon_start, drawn, greedy)

    def iterate(self, progress: float) -> dict[str, float]:
        """Sixteen steps of every game."""
        self.set_schedules(progress)
        if self.now is None:
            self.now = self.env.reset()
        if self.actions is None:
            self.actions = self.choose(self.now["observation"])
        losses = []
        for _ in range(16):
            taken = self.now.set("action", self.actions)
            stepped, following = self.env.step_and_maybe_reset(taken)
            after = stepped["next"]
            chosen = self.choose(after["observation"])
            with torch.no_grad():
                value = self.network(after["observation"]).gather(-1, chosen[:, None])
            going = ~after["terminated"]
            target = after["reward"] + self.settings.gamma * going * value
            found = self.network(stepped["observation"]).gather(-1, self.actions[:, None])
            loss = torch.nn.functional.mse_loss(found, target)
            self.descend(loss)
            losses.append(float(loss.detach()))
            anew = self.choose(following["observation"])
            self.actions = torch.where(after["done"][:, 0], anew, chosen)
            self.now = following
        self.frames += 16 * len(self.actions)
        return {"loss": sum(losses) / len(losses)}

    def state_dict(self) -> dict[str, Any]:
        """What every network's learner keeps, and the actions that come next."""
        return {**super().state_dict(), "actions": self.actions}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.actions = state["actions"]


def _network_of(settings: SarsaSettings, player: Seat, build: Build) -> QNetwork:
    return QNetwork(player.features, player.num_actions, build.hidden(settings)).to(build.device)


def _build(settings: SarsaSettings, env: Any, how: Build) -> Sarsa:
    return Sarsa(settings, env, _network_of(settings, env.player, how), how.device)


SARSA = Algorithm(
    "sarsa", SarsaSettings, _build, network_loader(_network_of), learns_distribution=False
)


# -- an algorithm with a loop of its own -----------------------------------------------------------


class Linear(nn.Module):
    """A linear policy."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.layer = nn.Linear(inputs, actions)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions]."""
        return self.layer(observation)


def linear_of(settings: LibraryPPOSettings, player: Seat, build: Build) -> FlatNetwork:
    """A new network for the player."""
    inputs = FlatInputs(player.features)
    return FlatNetwork(inputs, Linear(inputs.size, player.num_actions))


class PlainGradient(LearnedNetwork):
    """The policy gradient with the rewards of single steps: a library of a few lines."""

    def __init__(self, settings: LibraryPPOSettings, env: LearnerVectorEnv, build: Build) -> None:
        super().__init__(env, linear_of(settings, env.player, build))
        self.settings = settings
        self.optimizer = torch.optim.SGD(self.network.parameters(), settings.learning_rate)
        self.now = torch.from_numpy(env.reset(seed=build.seed)[0])

    def iterate(self, progress: float) -> dict[str, float]:
        """Some steps, and a step of gradient descent."""
        loss = torch.zeros(())
        for _ in range(self.settings.rollout_steps):
            policy: Any = torch.distributions.Categorical(
                logits=self.network.network.logits(self.now)
            )
            drawn = policy.sample()
            seen, reward, *_ = self.env.step(drawn.numpy())
            loss = loss - (policy.log_prob(drawn) * torch.from_numpy(reward)).mean()
            self.now = torch.from_numpy(seen)
            self.frames += len(drawn)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return {"loss_objective": float(loss)}


LOOP = Algorithm(
    "loop", LibraryPPOSettings, PlainGradient, network_loader(linear_of), own_loop=True
)
