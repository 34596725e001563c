"""Players of schedules on machines."""
