"""A long run in virtual time, with faults by chance, and what must hold of it."""
