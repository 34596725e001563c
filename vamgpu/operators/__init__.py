"""Linear operators between spaces on devices; they contain geometry and ray tables, but no physics."""
