"""Roll-to-roll printing: endless webs solved in segments, their frames, their limits and their report."""
