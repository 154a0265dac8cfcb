"""The kinematics and dynamics of a robot at a stack of joint positions, by the compiled kernel."""
