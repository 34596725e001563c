"""One print under one holder of the light, and what plays its schedule on the machines of a rig."""
