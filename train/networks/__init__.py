"""Networks, and policies that play with a trained network."""
