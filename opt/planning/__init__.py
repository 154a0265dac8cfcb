"""From a start and a target to a trajectory: `plan`, and many of them at once."""
