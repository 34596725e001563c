"""Which frame when: exact tables of slots, and what machines can do."""
