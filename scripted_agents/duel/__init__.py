"""One chaser against one evader: best responses, values, regret."""
