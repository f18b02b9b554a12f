"""What stands on the bench: supplies, cameras, what guards them, and their soft twins. It knows no model of the gel."""
