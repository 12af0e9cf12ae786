"""The arm: N joints in the plane that move a tip to a target.

The modules correspond to those for mazes: rules, simulator, observations, policy, environments and
rendering.
"""
