"""Sim-to-real: find, name and model the physics that a simulator leaves out."""
