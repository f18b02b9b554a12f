"""How sure a motion is: many runs over the scatter of material and start, counted and compared."""
