"""Linear operators between spaces on devices; they know geometry and ray tables, no physics."""
