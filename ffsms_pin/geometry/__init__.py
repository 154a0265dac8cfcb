"""The shapes of robots, obstacles and payloads, and their distances at instants and between instants."""
