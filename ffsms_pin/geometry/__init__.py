"""Shapes of robots, obstacles and payloads, and the distances between them, at instants and in between."""
