"""A person in a seat: games by hand, their page and their terminal, and what is kept of them."""
