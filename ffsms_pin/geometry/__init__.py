"""The shapes of robots, obstacles and payloads, and their distances at and between the nodes of a motion."""
