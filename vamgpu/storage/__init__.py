"""Files that outlive a run: job folders of arrays with a manifest, written whole or not at all."""
