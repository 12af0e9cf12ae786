"""PettingZoo, Gymnasium and Stable-Baselines3 environments over the simulator."""
