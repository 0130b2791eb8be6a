"""Recordings, devices and configurations of others: ROS bags, robot_localization's ekf.yaml."""
