"""ROS: bags in, poses out, and the nodes that run on a robot.

Whatever reads messages takes them by their fields alone, so that those of ``rosbags`` and those of
``rclpy`` are the same to it.
"""
