"""Agents without learning: heuristics and exact solvers.

Names imported as themselves are public.
"""

import importlib
import pkgutil
import sys

from scripted_agents import exact
from scripted_agents.agents.arm import IK_METHODS as IK_METHODS
from scripted_agents.agents.arm import InverseKinematics as InverseKinematics
from scripted_agents.agents.arm import RandomArm as RandomArm
from scripted_agents.agents.arm import ThesisInverseKinematics as ThesisInverseKinematics
from scripted_agents.agents.runner import NearestGoalRunner as NearestGoalRunner
from scripted_agents.agents.scripted import AStarChaser as AStarChaser
from scripted_agents.agents.scripted import AStarEvader as AStarEvader
from scripted_agents.agents.scripted import RandomAgent as RandomAgent
from scripted_agents.agents.searchers import SearchingChaser as SearchingChaser
from scripted_agents.agents.searchers import SearchingRunner as SearchingRunner
from scripted_agents.agents.searchers import SweepingChaser as SweepingChaser
from scripted_agents.agents.searchers import WaryEvader as WaryEvader
from scripted_agents.agents.table_policy import TablePolicy as TablePolicy
from scripted_agents.agents.uniform import UniformAgent as UniformAgent
from scripted_agents.exact.arm.least_steps import least_steps as least_steps
from scripted_agents.exact.arm.least_steps import least_steps_of as least_steps_of
from scripted_agents.exact.arm.policy import LeastStepsPolicy as LeastStepsPolicy
from scripted_agents.exact.duel.action_values import ActionValues as ActionValues
from scripted_agents.exact.duel.action_values import action_values as action_values
from scripted_agents.exact.duel.best_response import BestResponse as BestResponse
from scripted_agents.exact.duel.best_response import PairValues as PairValues
from scripted_agents.exact.duel.best_response import best_response as best_response
from scripted_agents.exact.duel.best_response import evaluate_exactly as evaluate_exactly
from scripted_agents.exact.duel.best_response import mean_over_starts as mean_over_starts
from scripted_agents.exact.graphs.cops_and_robbers import TurnBasedSolution as TurnBasedSolution
from scripted_agents.exact.graphs.cops_and_robbers import cop_number as cop_number
from scripted_agents.exact.graphs.cops_and_robbers import solve_in_turns as solve_in_turns
from scripted_agents.exact.hidden.beliefs import BeliefChaser as BeliefChaser
from scripted_agents.exact.hidden.beliefs import BeliefFilter as BeliefFilter
from scripted_agents.exact.hidden.beliefs import why_no_belief as why_no_belief
from scripted_agents.exact.hidden.chase import BeliefOptimalChaser as BeliefOptimalChaser
from scripted_agents.exact.hidden.chase import BeliefOptimalEvader as BeliefOptimalEvader
from scripted_agents.exact.hidden.chase import HiddenChaseSolution as HiddenChaseSolution
from scripted_agents.exact.hidden.chase import solve_hidden_chase as solve_hidden_chase
from scripted_agents.exact.hidden.game import HiddenCell as HiddenCell
from scripted_agents.exact.hidden.search import HiddenSearch as HiddenSearch
from scripted_agents.exact.joint.equilibrium import MatrixGame as MatrixGame
from scripted_agents.exact.joint.equilibrium import solve_chase as solve_chase
from scripted_agents.exact.joint.equilibrium import solve_matrix_game as solve_matrix_game
from scripted_agents.exact.joint.game import solve_joint_game as solve_joint_game
from scripted_agents.exact.joint.nash_conv import joint_nash_conv as joint_nash_conv
from scripted_agents.exact.joint.opponents import has_distributions as has_distributions
from scripted_agents.exact.joint.opponents import why_no_distribution as why_no_distribution
from scripted_agents.exact.joint.optimal import BestResponder as BestResponder
from scripted_agents.exact.joint.optimal import OptimalChaser as OptimalChaser
from scripted_agents.exact.joint.optimal import OptimalEvader as OptimalEvader
from scripted_agents.exact.joint.optimal import table_of as table_of
from scripted_agents.exact.joint.policy import JointPlan as JointPlan
from scripted_agents.exact.joint.policy import JointTable as JointTable
from scripted_agents.exact.joint.results import ChaseSolution as ChaseSolution
from scripted_agents.exact.joint.results import JointGame as JointGame
from scripted_agents.exact.joint.results import JointNashConv as JointNashConv
from scripted_agents.exact.joint.results import JointResponse as JointResponse
from scripted_agents.exact.joint.results import JointValues as JointValues
from scripted_agents.exact.joint.results import TeamResponse as TeamResponse
from scripted_agents.exact.joint.solver import best_team_response as best_team_response
from scripted_agents.exact.joint.solver import evaluate_joint as evaluate_joint
from scripted_agents.exact.joint.solver import evaluate_team as evaluate_team
from scripted_agents.exact.joint.solver import mean_over_team_starts as mean_over_team_starts
from scripted_agents.exact.joint.solver import solve_joint as solve_joint
from scripted_agents.exact.joint.solver import team_survival as team_survival
from scripted_agents.exact.joint.states import JointStates as JointStates
from scripted_agents.exact.limits import check_joint_states as check_joint_states
from scripted_agents.exact.limits import check_optimal as check_optimal
from scripted_agents.exact.limits import count_joint_states as count_joint_states
from scripted_agents.exact.limits import why_not_optimal as why_not_optimal
from scripted_agents.exact.limits import why_not_team_chase as why_not_team_chase
from scripted_agents.exact.limits import work_of as work_of
from scripted_agents.exact.populations.double_oracle import DoubleOracle as DoubleOracle
from scripted_agents.exact.populations.double_oracle import OracleIteration as OracleIteration
from scripted_agents.exact.populations.double_oracle import double_oracle as double_oracle
from scripted_agents.exact.populations.fictitious_play import FictitiousPlay as FictitiousPlay
from scripted_agents.exact.populations.fictitious_play import MatrixPlay as MatrixPlay
from scripted_agents.exact.populations.fictitious_play import fictitious_play as fictitious_play
from scripted_agents.exact.populations.fictitious_play import (
    matrix_fictitious_play as matrix_fictitious_play,
)
from scripted_agents.exact.populations.meta_strategies import PSRO as PSRO
from scripted_agents.exact.populations.meta_strategies import alpha_rank as alpha_rank
from scripted_agents.exact.populations.meta_strategies import meta_strategy as meta_strategy
from scripted_agents.exact.populations.meta_strategies import psro as psro
from scripted_agents.exact.tours.runner import TourRunner as TourRunner
from scripted_agents.exact.tours.tour import Estimate as Estimate
from scripted_agents.exact.tours.tour import Tour as Tour
from scripted_agents.exact.tours.tour import expected_tour_length as expected_tour_length
from scripted_agents.exact.tours.tour import num_states as num_states
from scripted_agents.exact.tours.tour import shortest_path as shortest_path
from scripted_agents.exact.tours.tour import shortest_tour as shortest_tour
from scripted_agents.exact.tours.tour import tour_length as tour_length
from scripted_agents.exact.tours.tour import tour_lengths as tour_lengths

# Modules of `exact` have their former names, without it, too: both are one module.
sys.modules.update(
    (each.name.replace(".exact.", ".", 1), importlib.import_module(each.name))
    for each in pkgutil.walk_packages(exact.__path__, f"{exact.__name__}.")
)
globals().update(
    (each.name, vars(exact)[each.name]) for each in pkgutil.iter_modules(exact.__path__)
)
