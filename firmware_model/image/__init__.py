"""From pixels to spots: adaptive threshold, run-length clustering, centre-of-mass centroids."""
