"""Planning during a print: a separate process receives the shown frames, estimates, and plans the coming turns."""
