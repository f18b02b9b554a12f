"""Who drives a robot: controllers that can be compared on the same robots."""
