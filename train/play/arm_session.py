"""Sessions with an arm, whose joints are all the person's."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.declared import number, whole
from pursuit.reacher.policy import ArmPolicy
from pursuit.reacher.rendering import scene_of, scene_to_text
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.replay_worlds import world_for
from scripted_agents import least_steps
from train.evaluation.arm_contest import ArmContest
from train.play.outcome import Outcome


class ArmSession:
    """Targets for an arm; a `train.play.session.Session`.

    Every game begins in a pose of its own, also where the task keeps poses: what it can be played
    in at best would else depend on the game before.

    Args:
        task: the arm.
        agent: what an agent is called that moves the same arm to the same targets.
        policy: the agent.
        seed: of the games, 0 to 2**64 - 1.
    """

    def __init__(self, task: ReacherTask, agent: str, policy: ArmPolicy, seed: int) -> None:
        self.task, self.agent, self.policy = task, agent, policy
        self.own = "arm"
        self.seed = whole("seed", seed, 0, 2**64 - 1)
        self.outcomes: list[Outcome] = []
        self.outcome: Outcome | None = None
        self.begin(0)

    def begin(self, game: int) -> None:
        """Begin the game of this number."""
        self.game, self.outcome = game, None
        self.simulator = ReacherSimulator(self.task, 1, self.seed, game, auto_restart=False)
        kept = world_for(self.task)
        self.start = kept.start(self.simulator, 0)
        self.states = [kept.state(self.simulator, 0)]
        self.actions: list[Any] = []
        self.rewards: list[list[float]] = []

    @property
    def over(self) -> bool:
        """The target is reached, or time is up."""
        return bool(self.simulator.ended[0])

    @property
    def step(self) -> int:
        """As `Session`."""
        return len(self.actions)

    def move(self, action: Any) -> None:
        """As `Session`: a list, the part of a whole turn of every joint in [-1, 1]."""
        if self.over:
            raise ValueError(f"game {self.game} is over; begin the next one")
        joints = self.task.joints
        if not isinstance(action, list) or len(action) != joints:
            raise ValueError(f"action={action!r}; a list of {joints} numbers in [-1, 1]")
        turns = [number("action", turn) for turn in action]
        if self.task.discrete_actions and not set(turns) <= {-1.0, 0.0, 1.0}:
            raise ValueError(f"action={action!r}; this arm has discrete actions: -1, 0 and 1")
        self.simulator.step(np.array([turns]))
        self.actions.append(turns)
        self.rewards.append([float(self.simulator.rewards[0])])
        self.states.append(world_for(self.task).state(self.simulator, 0))
        if self.over:
            self.outcome = self._outcome()
            self.outcomes.append(self.outcome)

    def next_game(self) -> None:
        """As `Session`."""
        self.begin(self.game + 1)

    def _outcome(self) -> Outcome:
        least, most = self.optimum(self.start["angles"], self.start["target"])
        arm = ReacherSimulator(self.task, 1, self.seed, self.game, auto_restart=False)
        while not arm.ended[0]:
            arm.step(self.policy.act(arm.view()))
        return Outcome(
            won=bool(self.simulator.terminated[0]),
            steps=self.step,
            reward=sum(paid for (paid,) in self.rewards),
            least=least,
            most=most,
            expected=False,
            agent=self.agent,
            agent_steps=int(arm.steps[0]),
            agent_won=bool(arm.terminated[0]),
        )

    def optimum(self, angles: list[float], target: list[float]) -> tuple[float, float | None]:
        """Bounds of the least steps from a start; the upper one is None with discrete actions."""
        task = self.task
        bounds = least_steps(angles, target, task.max_turn, task.tolerance)
        least, most = (
            float(min(max(steps, 1) + task.hold - 1, task.max_steps)) for steps in bounds
        )
        return least, None if task.discrete_actions else most

    def title(self) -> str:
        """As `Session`."""
        return ArmContest(self.task).line()

    def board(self) -> dict[str, Any]:
        """As `Session`."""
        task = self.task
        return {
            "kind": "arm",
            "joints": task.joints,
            "tolerance": task.tolerance,
            "max_steps": task.max_steps,
        }

    def frame(self) -> dict[str, Any]:
        """As `Session`."""
        arm = self.simulator
        return {
            "angles": arm.angles[0].tolist(),
            "target": arm.targets[0].tolist(),
            "step": self.step,
            "reward": self.rewards[-1][0] if self.rewards else 0.0,
        }

    def text(self) -> str:
        """As `Session`."""
        return scene_to_text(scene_of(self.simulator))

    def players(self) -> dict[str, str]:
        """As `Session`: nobody."""
        return {}
