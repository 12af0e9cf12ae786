"""The arm: inverse kinematics and the least number of steps."""
