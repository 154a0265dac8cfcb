"""The kinematics and dynamics of a robot at many joint positions at once, by the compiled kernel."""
