"""What is asked for: frozen dataclasses of plain values, checked at birth. No torch here."""
