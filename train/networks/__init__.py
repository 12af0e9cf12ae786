"""From an observation to a policy and a value; a trained network in any seat."""
