"""Docking: localize, move a little towards the goal, look again, until the robot stands there."""
