"""Single steps: the paper's step as a quadratic program in alpha, and rollouts of steps."""
