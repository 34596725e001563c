"""From a plan to frames a projector shows, and from their bytes back to light: packing, exporting, job folders."""
