"""What the resin does with the light: inhibitors, transport, materials."""
