"""CANopen in front of the device, as the star tracker card of a small satellite speaks it."""
