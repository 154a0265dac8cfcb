"""Re-planning in the closed loop over a receding horizon, warm-started by the rest of the last plan."""
