"""The solvers of the problem set: a solver takes a problem and a time [s], and returns a solution or None."""
