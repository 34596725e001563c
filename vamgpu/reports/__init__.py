"""What every report and picture share."""
