"""gelbot: simulate, control and understand robots made of electro-active polymer gel."""

__version__ = "0.1.0"
