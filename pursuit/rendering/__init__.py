"""Games as text and pictures, animations, and windows."""
