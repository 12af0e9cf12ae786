"""Scripted agents: A*, nearest goals, limited views, tables; inverse kinematics of the arm."""
