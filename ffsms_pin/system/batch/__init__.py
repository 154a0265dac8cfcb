"""The robot at many joint positions at once, by the compiled kernel."""
