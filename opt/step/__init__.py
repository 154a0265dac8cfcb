"""The paper's step: a quadratic program in alpha, solved by ProxQP."""
