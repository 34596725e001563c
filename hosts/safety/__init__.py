"""The light: one holder, its conditions, and the lease that turns it off."""
