"""The maze class, text formats, generators, and the included mazes and suites."""
