"""DeviceEnv: games on a GPU as a native TorchRL environment, without a copy and without waiting."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from pursuit.own_observations import is_ours
from pursuit.rules import layout
from train.environments.device_hooks import DeviceHook, Notes
from train.environments.device_policies import DevicePolicy, shared, tensors_at
from train.environments.hooks import EpisodeHook
from train.environments.lockstep import FLAGS
from train.networks.policy import Seat


class DeviceEnv(EnvBase):
    """What `SimulatorEnv` is, of one learner's seat, with games and tensors on one GPU.

    Keys, specs and games are those of `SimulatorEnv`. The tensors share the memory of the games;
    kernels run in torch's current stream, and nothing that is done in a step waits for them, unless
    a hook cannot say beforehand what it will settle (`device_hooks`). Frame stacks, masks of
    actions and several members are not for here.

    Args:
        simulator: made with `auto_restart=False` and a GPU.
        player: who learns; its encoding is observed.
        policies: whoever fills each seat, None in the learner's: by a kernel (`on_device`), or a
            `DevicePolicy`.
        hook: changes the next episodes; it must `foretell`.
        scale: rewards are multiplied by it.

    Raises:
        ValueError: a simulator that restarts games by itself, or a player or hook of what is not
            for here.

    Attributes:
        simulator, player, policies, hook, scale: the arguments.
        num_games: in the batch.
        idle: [num_games, 1] bool, on the CPU: nobody ever is.
        resume: set it to have the next full reset go on with the games as they stand.
    """

    members = 1

    def __init__(
        self,
        simulator: Any,
        player: Seat,
        policies: Sequence[Any],
        hook: EpisodeHook | None = None,
        scale: float = 1.0,
    ) -> None:
        if simulator.auto_restart:
            raise ValueError("this simulator restarts games by itself; take auto_restart=False")
        obstacle = why_not_on_device(player)
        if obstacle is not None:
            raise ValueError(f"{obstacle}; take device='cpu'")
        games = simulator.num_games
        super().__init__(device=tensors_at(simulator), batch_size=[games])
        self.simulator, self.player, self.policies = simulator, player, list(policies)
        self.hook, self.num_games, self.scale = hook or EpisodeHook(), games, scale
        self._far = DeviceHook(simulator, self.hook)
        self._by_kernels = [p if hasattr(p, "on_device") else None for p in self.policies]
        self._others: list[DevicePolicy] = [p for p in self.policies if hasattr(p, "play")]
        self.idle = np.zeros((games, 1), dtype=bool)
        self.resume = self.begun = False
        self.encoding, self.seat = player.encoding, player.number
        memory, seat = simulator.memory, self.seat
        agents, reals = shared(simulator, memory.agents), shared(simulator, memory.reals)
        flags, clocks = shared(simulator, memory.flags), shared(simulator, memory.clocks)
        self._active = agents[:, layout.ACTIVE, seat : seat + 1]
        self._rewards = shared(simulator, memory.rewards)[:, seat : seat + 1]
        self._terminated = flags[layout.ENDED_BY_RULE].unsqueeze(1)
        self._truncated = flags[layout.ENDED_BY_TIME].unsqueeze(1)
        self._returns = reals[:, layout.RETURNS, seat : seat + 1]
        self._steps = clocks[:, layout.STEPS].unsqueeze(1)
        self._actions = shared(simulator, simulator.actions)
        self._chosen = shared(simulator, simulator.chosen)
        self._shown: torch.Tensor | None = None
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

    def _in_stream(self) -> None:
        """Have the kernels run where torch's do."""
        if not self.simulator.simulated:
            self.simulator.stream = torch.cuda.current_stream(self.device).cuda_stream

    def _seen(self) -> dict[str, torch.Tensor]:
        """What the learner observes: a fresh tensor."""
        seen = self.simulator.observe(self.encoding, self.seat)  # always the same array
        if self._shown is None:
            self._shown = shared(self.simulator, seen)
        return {"observation": self._shown.clone()}

    def _batch(self, content: dict[str, torch.Tensor]) -> TensorDictBase:
        return TensorDict(content, batch_size=self.batch_size, device=self.device)

    def _play(self, actions: torch.Tensor) -> dict[str, torch.Tensor]:
        """One step with the learner's actions [num_games]: all after it."""
        self._in_stream()
        self.simulator.act(self._by_kernels)
        for policy in self._others:
            policy.play()
        self._actions[:, self.seat] = actions.to(torch.int32)
        self.simulator.step()
        caught = self._active == 0
        terminated = self._terminated | caught
        truncated = self._truncated & ~caught
        done = terminated | truncated
        counted = torch.stack([self._returns, self._steps.double()]) * done
        self._sums[:, 0] += counted.sum(dim=(1, 2))
        self._sums[:, 1] += done.sum()
        self._far.ended(done.squeeze(1))
        rewards = self._rewards * self.scale
        flags = dict(zip(FLAGS, (terminated, truncated, done), strict=True))
        return {**self._seen(), "reward": rewards, **flags}

    def _restart(self, games: torch.Tensor) -> None:
        """Begin new episodes in the games of the mask [num_games]."""
        self._in_stream()
        self._far.settle(games)
        self._chosen.copy_(games)
        self.simulator.reset(games=self.simulator.chosen)
        self._far.begun(games)

    def begin_rollout(self, steps: int) -> None:
        """Settle what the next so many steps need; it waits for the GPU."""
        self._in_stream()
        for policy in self._others:
            policy.begin_rollout()
        self._far.begin_rollout(steps)

    def end_rollout(self) -> None:
        """Tell the hook what happened; it waits for the GPU."""
        self._far.end_rollout()

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
        return self._batch(self._play(tensordict["action"]))

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """What `EnvBase.step_and_maybe_reset` does; the games that are over begin anew."""
        after, seen = self.step_tensors(tensordict["action"])
        flags = {name: torch.zeros_like(after["done"]) for name in FLAGS}
        return tensordict.set("next", self._batch(after)), self._batch({**seen, **flags})

    def step_tensors(
        self, actions: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """The same without TensorDicts: all after the step, and what is seen by whoever plays on.

        Args:
            actions: [num_games].
        """
        after = self._play(actions)
        self._restart(after["done"].flatten())
        return after, self._seen()

    # -- for whoever captures steps ----------------------------------------------------------------

    @property
    def notes(self) -> Notes:
        """What happened and was not told to the hook yet."""
        return self._far.notes

    @notes.setter
    def notes(self, notes: Notes) -> None:
        self._far.notes = notes

    def why_not_captured(self) -> str | None:
        """Why steps cannot be captured now; None where they can."""
        if self._far.waits:
            return f"{type(self.hook).__name__} must know in every step how many games end"
        if self.simulator.waits:
            return "starts at some distance can be rare, which every step waits for"
        return None

    def changed(self) -> list[torch.Tensor]:
        """All memory that a step changes, but what only matters within one."""
        return [*self._memory, self._sums, *self._far.changed()]

    @cached_property
    def _memory(self) -> list[torch.Tensor]:
        games = self.simulator
        arrays = (*games.memory, games.actions, games.chosen, games.rows, games.seeds, games.drawn)
        tensors = [shared(games, array) for array in arrays if array.size]
        # Torch has few operations on uint64.
        return [one.view(torch.int64) if one.dtype == torch.uint64 else one for one in tensors]

    def depends(self) -> Hashable:
        """What else the launches of a step depend on."""
        return self._far.depends(), tuple(policy.depends() for policy in self._others)

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
