"""Emulators use the protocols of real devices; only the rig that assembles them may import them."""
