"""Re-planning in the loop: a receding horizon that starts from the rest of the last plan."""
