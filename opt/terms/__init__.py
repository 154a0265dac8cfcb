"""Terms: what a motion should be like."""
