"""The paper's plain nonlinear step, for comparison."""
