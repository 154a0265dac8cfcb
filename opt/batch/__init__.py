"""The fast kernel: the arm at stacks of configurations, in numpy."""
