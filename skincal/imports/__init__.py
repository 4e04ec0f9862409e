"""Recordings of others, CSV files and ROS bags, turned into datasets by a mapping file."""
