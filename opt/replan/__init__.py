"""Re-planning in the closed loop: a receding horizon, warm-started by the rest of the last plan."""
