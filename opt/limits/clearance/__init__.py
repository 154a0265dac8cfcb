"""Clearances: how far the robot is from itself and from obstacles, and what keeps it clear."""
