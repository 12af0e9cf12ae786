"""What agents observe: encodings, limited sight, masks, and observations of users' own."""
