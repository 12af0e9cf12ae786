"""TorchRL environments over the simulators, and hooks that configure episodes."""
