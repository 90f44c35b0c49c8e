"""Gymnasium wrappers for the rig."""
