"""Goals of the end effector: desired poses and velocities at the deadline, paths and waypoints."""
