"""The race: learners of several libraries on the same tasks, tuned with the same number of runs."""
