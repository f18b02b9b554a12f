"""`gelbot live`: the bench, or a simulated one, in a browser."""
