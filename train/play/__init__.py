"""Games played by a user: the session, its web page, and saved replays."""
