"""Population methods with exact best responses: double oracle, fictitious play, PSRO."""
