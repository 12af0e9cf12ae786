"""Mazes: their form, text and other formats, generators; the files and suites that are shipped."""
