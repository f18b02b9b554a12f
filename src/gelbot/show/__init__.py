"""Pictures, movies and tables of runs; they need a run data set and no display."""
