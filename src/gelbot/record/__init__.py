"""Runs on disk, and their numbers."""
