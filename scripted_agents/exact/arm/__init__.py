"""The minimum number of steps of the arm, proven, and the policy that takes them."""
