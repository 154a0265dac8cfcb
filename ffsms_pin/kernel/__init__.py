"""The compiled kernel: what plans, steps and batches compute of the robot at stacks of configurations."""
