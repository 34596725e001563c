"""A plan printed in a small process that holds the light, machines, lease and record, independent of its parent."""
