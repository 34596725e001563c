"""From frames to the memory of mirrors, ahead of their time."""
