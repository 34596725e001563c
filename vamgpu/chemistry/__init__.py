"""Response of the resin to light: inhibitors, transport, materials."""
