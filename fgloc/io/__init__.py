"""What other programs write: ROS bags, configurations, the bytes of drivers."""
