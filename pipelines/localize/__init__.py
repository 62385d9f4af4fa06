"""Floor 5: the particle filter. Image to likelihood to belief to estimate to run file."""
