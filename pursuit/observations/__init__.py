"""Encodings of observations, limited views, action masks, and custom observations."""
