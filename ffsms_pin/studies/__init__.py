"""What a motion comes to, and what it takes: science about plans, without scenario files."""
