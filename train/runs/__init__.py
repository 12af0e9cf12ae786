"""One training loop, its folders, and the parts that settings become."""
