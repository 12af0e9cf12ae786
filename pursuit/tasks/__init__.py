"""Tasks: a maze, roles, rewards, placements and limited views."""
