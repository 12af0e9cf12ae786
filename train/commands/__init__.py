"""The face: the command `pursuit`. Nothing imports it."""
