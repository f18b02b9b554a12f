"""The directions of a body: what its shape allows, and what body and electrodes carry from one to another."""
