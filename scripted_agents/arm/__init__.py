"""Policies of the arm without learning: inverse kinematics and minimum steps."""
