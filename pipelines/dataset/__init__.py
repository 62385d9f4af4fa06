"""Floor 2: reading data sets: images, camera, odometry, ground truth.

A data set has the layout of the TUM RGB-D benchmark, or is a plain folder of images.
"""
