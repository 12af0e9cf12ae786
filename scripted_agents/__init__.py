"""Whoever plays without learning: heuristics and exact solvers."""

from scripted_agents.action_values import ActionValues, action_values
from scripted_agents.arm import (
    IK_METHODS,
    InverseKinematics,
    LeastStepsPolicy,
    RandomArm,
    ThesisInverseKinematics,
)
from scripted_agents.astar import shortest_path
from scripted_agents.beliefs import BeliefChaser, BeliefFilter, why_no_belief
from scripted_agents.best_response import (
    BestResponse,
    PairValues,
    best_response,
    evaluate_exactly,
    mean_over_starts,
)
from scripted_agents.chaser import AStarChaser
from scripted_agents.cops_and_robbers import TurnBasedSolution, cop_number, solve_in_turns
from scripted_agents.difficulty import Difficulty, maze_difficulty
from scripted_agents.duel_wins import duel_wins
from scripted_agents.equilibrium import (
    ChaseSolution,
    MatrixGame,
    solve_chase,
    solve_matrix_game,
)
from scripted_agents.evader import AStarEvader
from scripted_agents.hidden_chase import HiddenChaseSolution, solve_hidden_chase
from scripted_agents.hidden_game import HiddenCell
from scripted_agents.hidden_policy import BeliefOptimalChaser, BeliefOptimalEvader
from scripted_agents.hidden_search import HiddenSearch
from scripted_agents.independent import IndependentTeam, independent_team
from scripted_agents.joint import (
    JointResponse,
    JointValues,
    evaluate_joint,
    solve_joint,
)
from scripted_agents.joint_game import JointGame, solve_joint_game
from scripted_agents.joint_nash import JointNashConv, joint_nash_conv
from scripted_agents.joint_opponents import why_no_distribution
from scripted_agents.joint_policy import JointPlan, JointTable
from scripted_agents.joint_states import JointStates, check_joint_states, count_joint_states
from scripted_agents.least_steps import least_steps, least_steps_of
from scripted_agents.optimal import (
    BestResponder,
    OptimalChaser,
    OptimalEvader,
    check_optimal,
    table_of,
    why_not_optimal,
)
from scripted_agents.regret import DuelRegret, duel_regret
from scripted_agents.runner import NearestGoalRunner, TourRunner
from scripted_agents.scripted import RandomAgent
from scripted_agents.searchers import (
    SearchingChaser,
    SearchingRunner,
    SweepingChaser,
    WaryEvader,
)
from scripted_agents.table_policy import TablePolicy
from scripted_agents.teams import (
    TeamResponse,
    best_team_response,
    evaluate_team,
    has_distributions,
    mean_over_team_starts,
    team_survival,
    why_not_team_chase,
    work_of,
)
from scripted_agents.tour import (
    Estimate,
    Tour,
    expected_tour_length,
    num_states,
    shortest_tour,
    tour_length,
    tour_lengths,
)
from scripted_agents.worst_case import SearchPlan, fewest_searchers, fewest_steps_to_find

__all__ = [
    "IK_METHODS",
    "AStarChaser",
    "AStarEvader",
    "ActionValues",
    "BeliefChaser",
    "BeliefFilter",
    "BeliefOptimalChaser",
    "BeliefOptimalEvader",
    "BestResponder",
    "BestResponse",
    "ChaseSolution",
    "Difficulty",
    "DuelRegret",
    "Estimate",
    "HiddenCell",
    "HiddenChaseSolution",
    "HiddenSearch",
    "IndependentTeam",
    "InverseKinematics",
    "JointGame",
    "JointNashConv",
    "JointPlan",
    "JointResponse",
    "JointStates",
    "JointTable",
    "JointValues",
    "LeastStepsPolicy",
    "MatrixGame",
    "NearestGoalRunner",
    "OptimalChaser",
    "OptimalEvader",
    "PairValues",
    "RandomAgent",
    "RandomArm",
    "SearchPlan",
    "SearchingChaser",
    "SearchingRunner",
    "SweepingChaser",
    "TablePolicy",
    "TeamResponse",
    "ThesisInverseKinematics",
    "Tour",
    "TourRunner",
    "TurnBasedSolution",
    "WaryEvader",
    "action_values",
    "best_response",
    "best_team_response",
    "check_joint_states",
    "check_optimal",
    "cop_number",
    "count_joint_states",
    "duel_regret",
    "duel_wins",
    "evaluate_exactly",
    "evaluate_joint",
    "evaluate_team",
    "expected_tour_length",
    "fewest_searchers",
    "fewest_steps_to_find",
    "has_distributions",
    "independent_team",
    "joint_nash_conv",
    "least_steps",
    "least_steps_of",
    "maze_difficulty",
    "mean_over_starts",
    "mean_over_team_starts",
    "num_states",
    "shortest_path",
    "shortest_tour",
    "solve_chase",
    "solve_hidden_chase",
    "solve_in_turns",
    "solve_joint",
    "solve_joint_game",
    "solve_matrix_game",
    "table_of",
    "team_survival",
    "tour_length",
    "tour_lengths",
    "why_no_belief",
    "why_no_distribution",
    "why_not_optimal",
    "why_not_team_chase",
    "work_of",
]
