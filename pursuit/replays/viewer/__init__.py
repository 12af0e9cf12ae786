"""The viewer: a self-contained page of plain JavaScript and SVG for replays, reports and play."""
