"""What a motion is and how far a run came in it: the goals of a scenario, judged on a run's data set."""
