"""Gels to be controlled: simulated, recorded, real."""
