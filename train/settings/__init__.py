"""Settings as frozen dataclasses of plain values, validated on construction. No torch here."""
