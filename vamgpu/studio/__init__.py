"""Studio: a page in the browser for jobs, their solution, proofs and prints, on this machine only."""
