"""What the user writes, checked; the scenarios that come with gelbot."""

from gelbot.scenario.load import Loaded, built_in_text, description, load, names

__all__ = ["Loaded", "built_in_text", "description", "load", "names"]
