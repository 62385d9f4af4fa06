"""Floor 3: camera poses from structure from motion, odometry or a file, metric and z up."""
