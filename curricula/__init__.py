"""Curricula: they choose the stages and levels of training. No imports of `pursuit` or torch.

Names imported as themselves are public.
"""

from curricula.levels import LevelReplay as LevelReplay
from curricula.pools import PoolReplay as PoolReplay
from curricula.protocol import Change as Change
from curricula.protocol import Curriculum as Curriculum
from curricula.protocol import Outcomes as Outcomes
from curricula.schedules import Progress as Progress
from curricula.schedules import Schedule as Schedule
from curricula.schedules import constant as constant
from curricula.schedules import cosine as cosine
from curricula.schedules import exponential as exponential
from curricula.schedules import linear as linear
from curricula.schedules import piecewise as piecewise
from curricula.schedules import step as step
from curricula.stages import LearningProgress as LearningProgress
from curricula.stages import Scheduled as Scheduled
from curricula.stages import Shuffled as Shuffled
from curricula.stages import SuccessGated as SuccessGated
from curricula.stages import Uniform as Uniform
