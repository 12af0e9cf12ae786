"""Third-party learners on our games: each a script to run, read and change."""
