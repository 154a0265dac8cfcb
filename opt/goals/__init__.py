"""Goals: where the end effector should be at the deadline, and how it should arrive."""
