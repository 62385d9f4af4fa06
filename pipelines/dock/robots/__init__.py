"""Robots behind the docking protocol: simulated ones, recorded ones, the user's own."""
