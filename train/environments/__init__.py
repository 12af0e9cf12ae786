"""TorchRL environments over the simulators, and the hooks of whoever changes the next episode."""
