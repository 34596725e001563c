"""What is known of a print: its state, the folder of its run, and what that proves."""
