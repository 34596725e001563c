"""Records of a print: its state, the folder of its run, and their proof."""
