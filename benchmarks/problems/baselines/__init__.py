"""The solvers of the problem set; each takes a problem and a CPU time [s], and returns a solution or None."""
