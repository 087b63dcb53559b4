"""Languages in front of the device: octets to commands, reports to octets."""
