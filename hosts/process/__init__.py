"""A plan carried out, in a small process that holds the light: machines, lease and record, whatever its parent does."""
