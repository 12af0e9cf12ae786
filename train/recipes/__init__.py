"""Example scripts that train learners of other libraries in the environments of Pursuit."""
