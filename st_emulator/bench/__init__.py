"""The assembly: a device behind its dialect and wire, in its world, on one clock."""
