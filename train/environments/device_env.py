"""DeviceEnv: games on a GPU as a native TorchRL environment, without a copy and without waiting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from pursuit.own_observations import is_ours
from pursuit.rules import layout
from train.environments.hooks import EpisodeHook
from train.environments.lockstep import FLAGS
from train.networks.policy import Seat


class DeviceEnv(EnvBase):
    """What `SimulatorEnv` is, of one learner's seat, with games and tensors on one GPU.

    Keys, specs and games are those of `SimulatorEnv`. The tensors share the memory of the games;
    kernels run in torch's current stream, and nothing that is done in a step waits for them. Frame
    stacks, masks of actions, several members and hooks are not for here.

    Args:
        simulator: made with `auto_restart=False` and a GPU.
        player: who learns; its encoding is observed.
        policies: whoever fills each seat; None in the learner's.

    Raises:
        ValueError: a simulator that restarts games by itself, or a player of what is not for here.

    Attributes:
        simulator, player, policies: the arguments.
        hook: does nothing.
        num_games: in the batch.
        resume: set it to have the next full reset go on with the games as they stand.
    """

    members = 1

    def __init__(self, simulator: Any, player: Seat, policies: Sequence[Any]) -> None:
        if simulator.auto_restart:
            raise ValueError("this simulator restarts games by itself; take auto_restart=False")
        obstacle = why_not_on_device(player)
        if obstacle is not None:
            raise ValueError(f"{obstacle}; take device='cpu'")
        games = simulator.num_games
        # Numba's simulator of a GPU has its arrays on the CPU.
        device = "cpu" if simulator.simulated else simulator.device
        super().__init__(device=device, batch_size=[games])
        self.simulator, self.player, self.policies = simulator, player, list(policies)
        self.hook, self.num_games = EpisodeHook(), games
        self.resume = self.begun = False
        self.encoding, self.seat = player.encoding, player.number
        memory, seat = simulator.memory, self.seat
        agents, reals = self._shared(memory.agents), self._shared(memory.reals)
        flags, clocks = self._shared(memory.flags), self._shared(memory.clocks)
        self._active = agents[:, layout.ACTIVE, seat : seat + 1]
        self._rewards = self._shared(memory.rewards)[:, seat : seat + 1]
        self._terminated = flags[layout.ENDED_BY_RULE].unsqueeze(1)
        self._truncated = flags[layout.ENDED_BY_TIME].unsqueeze(1)
        self._returns = reals[:, layout.RETURNS, seat : seat + 1]
        self._steps = clocks[:, layout.STEPS].unsqueeze(1)
        self._actions = self._shared(simulator.actions)
        self._chosen = self._shared(simulator.chosen)
        self._sums = torch.zeros(2, 2, dtype=torch.float64, device=self.device)
        self._specify()

    def _specify(self) -> None:
        batch = self.num_games
        space = self.simulator.encoder(self.encoding).space
        dtype = torch.from_numpy(np.zeros(1, dtype=space.dtype)).dtype
        shape = (batch, *space.shape)
        low, high = (
            torch.as_tensor(bound, dtype=dtype, device=self.device).expand(shape)
            for bound in (space.low, space.high)
        )
        seen = Bounded(low, high, shape=shape, dtype=dtype, device=self.device)
        self.observation_spec = Composite({"observation": seen}, shape=(batch,), device=self.device)
        self.action_spec = Categorical(
            self.player.num_actions, shape=(batch,), dtype=torch.int64, device=self.device
        )
        self.reward_spec = Unbounded((batch, 1), device=self.device)
        flag = Binary(n=1, shape=(batch, 1), dtype=torch.bool, device=self.device)
        flags = {key: flag.clone() for key in FLAGS}
        self.full_done_spec = Composite(flags, shape=(batch,), device=self.device)

    def _shared(self, array: Any) -> torch.Tensor:
        """A tensor over the same memory."""
        if self.simulator.simulated:
            return torch.from_numpy(array._ary)
        return torch.as_tensor(array, device=self.device)

    def _in_stream(self) -> None:
        """Have the kernels run where torch's do."""
        if not self.simulator.simulated:
            self.simulator.stream = torch.cuda.current_stream(self.device).cuda_stream

    def _seen(self) -> dict[str, torch.Tensor]:
        """What the learner observes: a fresh tensor."""
        seen = self.simulator.observe(self.encoding, self.seat)
        return {"observation": self._shared(seen).clone()}

    def _batch(self, content: dict[str, torch.Tensor]) -> TensorDictBase:
        return TensorDict(content, batch_size=self.batch_size, device=self.device)

    def _play(self, actions: torch.Tensor) -> TensorDictBase:
        """One step with the learner's actions [num_games]: all after it."""
        self._in_stream()
        self.simulator.act(self.policies)
        self._actions[:, self.seat] = actions.to(torch.int32)
        self.simulator.step()
        caught = self._active == 0
        terminated = self._terminated | caught
        truncated = self._truncated & ~caught
        done = terminated | truncated
        counted = torch.stack([self._returns, self._steps.double()]) * done
        self._sums[:, 0] += counted.sum(dim=(1, 2))
        self._sums[:, 1] += done.sum()
        flags = dict(zip(FLAGS, (terminated, truncated, done), strict=True))
        return self._batch({**self._seen(), "reward": self._rewards.clone(), **flags})

    def _restart(self, games: torch.Tensor) -> None:
        """Begin new episodes in the games of the mask [num_games]."""
        self._in_stream()
        self._chosen.copy_(games)
        self.simulator.reset(games=self.simulator.chosen)

    def begin(self) -> None:
        """New episodes in all games; the first time those of the simulator's seed."""
        if not self.begun and self.simulator.last_seed is not None:
            self.simulator.seed(self.simulator.last_seed)
        self.begun = True
        self._restart(torch.ones_like(self._chosen))

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            self._restart(tensordict["_reset"].flatten())
        elif not self.resume:
            self.begin()
        self.resume = False
        return self._batch(self._seen())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._play(tensordict["action"])

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """What `EnvBase.step_and_maybe_reset` does; the games that are over begin anew."""
        after = self._play(tensordict["action"])
        self._restart(after["done"].flatten())
        flags = {name: torch.zeros_like(after["done"]) for name in FLAGS}
        return tensordict.set("next", after), self._batch({**self._seen(), **flags})

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulator.seed(seed)

    @property
    def finished_returns(self) -> list[NDArray[Any]]:
        """The mean return of the episodes that ended since this was last asked, [1]; or nothing.

        It waits for the GPU.
        """
        return self._taken(0)

    @property
    def finished_lengths(self) -> list[NDArray[Any]]:
        """Likewise their mean length."""
        return self._taken(1)

    def _taken(self, row: int) -> list[NDArray[Any]]:
        total, count = self._sums[row].tolist()
        self._sums[row] = 0.0
        return [np.array([total / count])] if count else []


def why_not_on_device(player: Seat) -> str | None:
    """Why a player's games cannot lie on a GPU; None where they can."""
    if player.frame_stack > 1:
        return f"frame_stack={player.frame_stack}: frames are stacked on the CPU"
    if player.mask_bumps:
        return "mask_bumps=True: masks of actions are made on the CPU"
    if not is_ours(player.encoding):
        return f"observation={player.encoding!r} is your own, and is made on the CPU"
    return None
