"""What a planar lidar sees: scans, straight pieces of wall in them, and the map they make."""
