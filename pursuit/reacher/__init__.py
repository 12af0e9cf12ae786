"""The arm: N joints in the plane that bring a tip to a target.

The same shape as the mazes' world, in small: `rules.py` (the rule book), `simulator.py`,
`observations.py`, `policy.py`, environments and pictures.
"""
