"""Faults: what may go wrong with a unit and its wire, each at a named seam."""
