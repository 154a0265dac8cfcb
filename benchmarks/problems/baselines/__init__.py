"""What plans the problem set: a solver takes a problem and a time [s] and gives a solution, or None."""
