"""Files that outlive a run: job folders of arrays with a manifest, written completely or not at all."""
