"""The paper's step: one quadratic programme in alpha on ProxQP."""
