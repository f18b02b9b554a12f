"""The field of a scenario, from a checked scenario to a folder of numbers, files and pictures."""
