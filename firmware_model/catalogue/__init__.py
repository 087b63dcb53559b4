"""Star catalogue, pair catalogue and the k-vector that searches it: one catalogue for both modes."""
