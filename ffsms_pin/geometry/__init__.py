"""The shapes of robots, obstacles and payloads, and the distances between shapes along a motion."""
