"""Floor 1: poses, cameras, planes, trajectories: functions of arrays; of files only TUM text."""
