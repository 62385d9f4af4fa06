"""Floor 1: poses, cameras, planes, trajectories. Pure functions of arrays, no files but TUM text."""
