"""Jobs: a TOML file is checked, solved, and written to a folder that can be proved later."""
