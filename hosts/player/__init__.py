"""One print with one holder of the light, and the players of its schedule on a rig."""
