"""Floor 0: errors, atomic files, safe HDF5, provenance. Knows nothing of cameras or robots."""
