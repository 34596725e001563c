"""The light: one holder, what must hold for it, and the lease that lets it go."""
