"""Tasks: a maze, roles, rewards, placements and limits of sight."""
