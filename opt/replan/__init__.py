"""Re-planning in the loop: a receding horizon, warm-started by the rest of the last plan."""
