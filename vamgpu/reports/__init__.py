"""Pages, charts and styles that all reports and pictures share."""
