"""How well a policy plays, beside the exact references."""
