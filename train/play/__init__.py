"""Games by hand: the session, its page, and the replays that are kept."""
