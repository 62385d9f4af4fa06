"""Docking: localize, move a little towards the goal, take an image, until the robot is there."""
