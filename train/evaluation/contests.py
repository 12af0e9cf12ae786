"""The contest of any task."""

from __future__ import annotations

from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.small_game_contest import SmallGameContest
from train.evaluation.suite_contest import SuiteContest

AnyContest = GameContest | SuiteContest | ArmContest | SmallGameContest
