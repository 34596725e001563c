"""Jobs: what a TOML file asks for, checked, carried out, and written to a folder that can be proven later."""
