"""A small process holds the light: machines, lease and record in a child, whatever its parent and pages do."""
