"""What plays a schedule on machines."""
